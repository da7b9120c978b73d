"""A Go1, a Go2 or another robot with its cameras and, on request, RViz."""

from flexx2_sim_ros.paths import config_dir, executable
from flexx2_sim_ros.robots.robot import load_robot
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PASSED_ON = ('robot', 'motion', 'scene', 'renderer')  # to go1_cameras
ARGUMENTS = {
    'robot': ('go1', 'The robot: go1, go2, or the path of a YAML file.'),
    'motion': ('cmd_vel', 'What moves the robot: stand, cmd_vel or external.'),
    'scene': (
        'lab',
        'The scene: lab, stairs, corner, board, rubble, or the path of an MJCF file.',
    ),
    'renderer': ('auto', 'How images are rendered: auto, egl, osmesa or ray.'),
    'usecase': ('Mode_9_30fps', 'Mode of all cameras.'),
    'rviz': ('false', 'Whether to start RViz: true or false.'),
}


def generate_launch_description() -> LaunchDescription:
    """Start go1_cameras, a flexx2_camera for each of its cameras, and RViz on request."""
    robot = Node(
        executable=str(executable('go1_cameras')),
        output='screen',
        parameters=[{name: LaunchConfiguration(name) for name in PASSED_ON}],
    )
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
    return LaunchDescription([*arguments, robot, OpaqueFunction(function=_cameras), rviz])


def _cameras(context: LaunchContext) -> list[Node]:
    # Which cameras there are is known when the argument `robot` is.
    robot = load_robot(LaunchConfiguration('robot').perform(context))
    return [
        Node(
            executable=str(executable('flexx2_camera')),
            namespace=mount.name,
            output='screen',
            parameters=[{'usecase': LaunchConfiguration('usecase'), 'use_sim_time': True}],
        )
        for mount in robot.mounts
    ]
