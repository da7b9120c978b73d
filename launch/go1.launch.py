"""A Go1, a Go2 or another robot with its cameras and, on request, RViz."""

from flexx2_sim_ros.paths import config_dir, executable
from flexx2_sim_ros.robots.robot import load_robot
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ROBOT = ('robot', 'motion', 'scene', 'renderer', 'profile', 'rate')  # parameters of go1_cameras
CAMERA = ('usecase', 'effects', 'profile', 'use_sim_time')  # of each flexx2_camera
# All others are text, whatever it looks like.
KINDS = {'rate': float, 'use_sim_time': bool, 'one_process': bool}
ARGUMENTS = {
    'robot': ('go1', 'The robot: go1, go2, or the path of a YAML file.'),
    'motion': ('cmd_vel', 'What moves the robot: stand, cmd_vel or external.'),
    'scene': (
        'lab',
        'The scene: lab, stairs, corner, board, rubble, or the path of an MJCF file.',
    ),
    'renderer': ('auto', 'How images are rendered: auto, egl, osmesa or ray.'),
    'rate': ('60.0', 'Frames a second that go1_cameras renders of each camera, Hz.'),
    'usecase': ('Mode_9_30fps', 'Mode of all cameras.'),
    'effects': ('', 'Effects of all cameras: a preset, e.g. typical, or the path of a YAML file.'),
    'profile': ('', 'Profile of all cameras; empty for the Flexx2.'),
    'namespace': ('', 'Namespace of all nodes.'),
    'use_sim_time': ('true', 'Whether the cameras and RViz follow /clock.'),
    'one_process': ('false', 'Whether all cameras share one process: true or false.'),
    'rviz': ('false', 'Whether to start RViz: true or false.'),
}


def generate_launch_description() -> LaunchDescription:
    """Start RViz on request, go1_cameras, and flexx2_camera for its cameras."""
    # Before the others: where it is not installed, nothing else has been started.
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        output='screen',
        arguments=['-d', str(config_dir() / 'flexx2.rviz')],
        parameters=[_values(('use_sim_time',))],
        condition=IfCondition(LaunchConfiguration('rviz')),
        on_exit=_end,
    )
    robot = Node(
        executable=str(executable('go1_cameras')),
        namespace=LaunchConfiguration('namespace'),
        output='screen',
        parameters=[_values(ROBOT)],
        on_exit=_end,
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    check, cameras = (OpaqueFunction(function=function) for function in (_check, _cameras))
    return LaunchDescription([*arguments, check, rviz, robot, cameras])


def _values(names: tuple[str, ...]) -> dict[str, ParameterValue]:
    return {
        name: ParameterValue(LaunchConfiguration(name), value_type=KINDS.get(name, str))
        for name in names
    }


def _end(event: ProcessExited, context: LaunchContext) -> list[Action]:
    # The first that ends ends all others; one that failed makes the exit status 1.
    if context.is_shutdown:
        return []
    failed = (
        [OpaqueFunction(function=_fail, args=[event.process_name])] if event.returncode else []
    )
    return [Shutdown(reason=f'{event.process_name} ended'), *failed]


def _fail(_: LaunchContext, name: str) -> None:
    raise RuntimeError(f'{name} failed')


def _check(context: LaunchContext) -> None:
    # An exception ends the launch, but not the nodes that it has started: hence before all.
    load_robot(LaunchConfiguration('robot').perform(context))
    for name in ('go1_cameras', 'flexx2_camera'):
        executable(name)
    for value in _values((*ROBOT, *CAMERA, 'one_process')).values():
        value.evaluate(context)


def _cameras(context: LaunchContext) -> list[Node]:
    # Which cameras there are is known when the argument `robot` is.
    robot = load_robot(LaunchConfiguration('robot').perform(context))
    names = [mount.name for mount in robot.mounts]
    together = _values(('one_process',))['one_process'].evaluate(context)
    return [
        Node(
            executable=str(executable('flexx2_camera')),
            namespace=LaunchConfiguration('namespace'),
            output='screen',
            arguments=group,
            parameters=[_values(CAMERA)],
            on_exit=_end,
        )
        for group in ([names] if together else [[name] for name in names])
    ]
