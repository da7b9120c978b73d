"""What ``flexx2_camera --help`` and ``go1_cameras --help`` print; imports no ROS."""

from contextlib import suppress
import sys

CAMERA = """usage: flexx2_camera [NAMESPACE ...] [--ros-args ...]

A simulated Flexx2: reads clean depth, publishes what the camera would have seen.
With namespaces: a camera in each of them, all in one process.

reads      clean/depth_image, clean/camera_info, clean/reflectivity (optional)
publishes  ~/depth_image_0, ~/camera_info, ~/point_cloud_0, ~/gray_image_0,
           ~/depth_noise_0, /diagnostics
parameters usecase (the mode; flexx2 modes lists them), effects, effect.*,
           profile, seed, serial, frame_id, invalid_value, use_sim_time, ...
           ros2 param describe explains each

example: flexx2_camera --ros-args -r __ns:=/front_left -p usecase:=Mode_5_60fps
         flexx2_camera front_left front_right --ros-args --params-file cameras.yaml"""
ROBOT = """usage: go1_cameras [--ros-args ...]

A Unitree Go1 or Go2 in MuJoCo that publishes the clean depth of its cameras.

reads      cmd_vel, joint_states and odom of another simulator (motion:=external)
publishes  <camera>/clean/depth_image, <camera>/clean/camera_info,
           <camera>/clean/reflectivity, /clock, /tf, odom, joint_states
parameters robot, motion, scene, renderer, rate, profile, frame_prefix, ...
           ros2 param describe explains each

example: go1_cameras --ros-args -p scene:=stairs -p motion:=cmd_vel"""


def printed(text: str) -> bool:
    """Print a text where the process was asked for help, and say so."""
    asked = any(word in ('-h', '--help') for word in sys.argv[1:])
    if asked:
        with suppress(BrokenPipeError):
            print(text, flush=True)
    return asked
