# Build and test in a ROS 2 workspace of the official image:
#   docker build -t flexx2_sim_ros . && docker run --rm -it flexx2_sim_ros
FROM ros:jazzy-ros-base

SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /workspace
COPY . src/flexx2_sim_ros

# What package.xml names, all from apt.
RUN apt-get update \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --rosdistro jazzy -y \
    && rm -rf /var/lib/apt/lists/*

# numba 0.58 takes minutes to compile the camera. Nothing is installed if Ubuntu's is later.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pip \
    && pip install --no-cache-dir --break-system-packages 'numba>=0.59' \
    && rm -rf /var/lib/apt/lists/*

RUN source /opt/ros/jazzy/setup.bash && colcon build

# Without what only pip has, the camera node runs.
RUN source install/setup.bash \
    && ros2 run flexx2_sim_ros flexx2 modes \
    && (timeout --signal=INT 20 ros2 run flexx2_sim_ros flexx2_camera 2>&1 | tee /tmp/node.log; \
        grep 'waiting for' /tmp/node.log)

# What only pip has, for go1_cameras, bags and the tests: the latest that Ubuntu's numpy allows.
# hadolint ignore=DL3008,DL3013
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pytest-xdist libegl1 libgl1-mesa-dri \
    && pip install --no-cache-dir --break-system-packages mujoco rosbags \
    && rm -rf /var/lib/apt/lists/*

# Tests skip what is not here and say so; docker build stops at the first failure.
RUN source install/setup.bash \
    && colcon test --pytest-args -n 2 --dist loadfile \
    && colcon test-result --verbose

CMD ["bash", "-c", "source install/setup.bash && exec bash"]
