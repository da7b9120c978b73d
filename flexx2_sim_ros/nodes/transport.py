"""Shared memory for large messages."""

import os

from flexx2_sim_ros.paths import config_dir

PROFILE_VARIABLES = (
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTDDS_BUILTIN_TRANSPORTS',
)


def make_room_for_images() -> None:
    """
    Give the publishers of this process more shared memory; to be called before ``rclpy.init``.

    ``config/fastdds.xml`` explains why. A user's own configuration of Fast DDS, in any of its
    environment variables, has priority. Other middleware ignores it.
    """
    if not any(os.environ.get(name) for name in PROFILE_VARIABLES):
        os.environ[PROFILE_VARIABLES[0]] = str(config_dir() / 'fastdds.xml')
