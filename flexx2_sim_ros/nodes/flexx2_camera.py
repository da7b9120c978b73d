"""The executable `flexx2_camera`."""

import sys

from flexx2_sim_ros.nodes.runtime import leave_at_once_on_signals, run_node


def main() -> int:
    """Run the camera node until it is told to stop."""
    leave_at_once_on_signals()
    # Imported here, since it takes a second in which a signal would leave a traceback.
    from flexx2_sim_ros.nodes.camera_node import Flexx2Camera
    return run_node(Flexx2Camera)


if __name__ == '__main__':
    sys.exit(main())
