"""The simulated camera under the names of the vendor's driver (pmd-royale-ros)."""

from flexx2_sim_ros.paths import config_dir, executable
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

INPUTS = ('depth_image', 'camera_info', 'reflectivity')


def generate_launch_description() -> LaunchDescription:
    """Start one camera node; its inputs, parameters and namespace are arguments."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'namespace', default_value='', description='Namespace of the node.'
            ),
            DeclareLaunchArgument(
                'params_file',
                description='Parameter file of the node.',
                default_value=str(config_dir() / 'flexx2_driver.yaml'),
            ),
            *(
                DeclareLaunchArgument(
                    topic,
                    default_value=f'clean/{topic}',
                    description=f'Topic of the simulator for the input clean/{topic}.',
                )
                for topic in INPUTS
            ),
            # By its path: launch does not find the executables of a pip install by package.
            Node(
                executable=str(executable('flexx2_camera')),
                name='pmd_royale_ros_camera_node',
                namespace=LaunchConfiguration('namespace'),
                parameters=[LaunchConfiguration('params_file')],
                remappings=[(f'clean/{topic}', LaunchConfiguration(topic)) for topic in INPUTS],
                output='screen',
            ),
        ]
    )
