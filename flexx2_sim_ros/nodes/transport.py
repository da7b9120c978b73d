"""Room for large messages."""

import os

from flexx2_sim_ros.paths import config_dir

_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE',
             'FASTDDS_BUILTIN_TRANSPORTS')


def make_room_for_images() -> None:
    """
    Give what this process publishes more shared memory, before ``rclpy.init``.

    Why is said in ``config/fastdds.xml``. Somebody's own configuration of Fast DDS, in any of its
    environment variables, is left as it is; other middleware does not look at it.
    """
    if not any(os.environ.get(name) for name in _PROFILES):
        os.environ[_PROFILES[0]] = str(config_dir() / 'fastdds.xml')
