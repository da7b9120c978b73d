"""A Go1 or Go2 with its two cameras and, on request, RViz."""

from flexx2_sim_ros.paths import config_dir, executable
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PASSED_ON = ('robot', 'motion', 'scene', 'renderer')  # to go1_cameras
CAMERAS = ('front_left', 'front_right')
ARGUMENTS = {
    'robot': ('go1', 'The robot: go1, go2, or the path of a YAML file.'),
    'motion': ('cmd_vel', 'What moves the robot: stand, cmd_vel or external.'),
    'scene': (
        'lab',
        'The scene: lab, stairs, corner, board, rubble, or the path of an MJCF file.',
    ),
    'renderer': ('auto', 'How images are rendered: auto, egl, osmesa or ray.'),
    'usecase': ('Mode_9_30fps', 'Mode of both cameras.'),
    'rviz': ('false', 'Whether to start RViz: true or false.'),
}


def generate_launch_description() -> LaunchDescription:
    """Start go1_cameras, a flexx2_camera for each of its cameras, and RViz on request."""
    robot = Node(
        executable=str(executable('go1_cameras')),
        output='screen',
        parameters=[{name: LaunchConfiguration(name) for name in PASSED_ON}],
    )
    cameras = [
        Node(
            executable=str(executable('flexx2_camera')),
            namespace=camera,
            output='screen',
            parameters=[{'usecase': LaunchConfiguration('usecase'), 'use_sim_time': True}],
        )
        for camera in CAMERAS
    ]
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        output='screen',
        arguments=['-d', str(config_dir() / 'flexx2.rviz')],
        parameters=[{'use_sim_time': True}],
        condition=IfCondition(LaunchConfiguration('rviz')),
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, robot, *cameras, rviz])
