"""Room for large messages."""

import os

from flexx2_sim_ros.paths import config_dir

PROFILE_VARIABLES = (
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTDDS_BUILTIN_TRANSPORTS',
)


def make_room_for_images() -> None:
    """
    Give what this process publishes more shared memory, before ``rclpy.init``.

    Why is said in ``config/fastdds.xml``. Somebody's own configuration of Fast DDS, in any of its
    environment variables, is left as it is; other middleware does not look at it.
    """
    if not any(os.environ.get(name) for name in PROFILE_VARIABLES):
        os.environ[PROFILE_VARIABLES[0]] = str(config_dir() / 'fastdds.xml')
