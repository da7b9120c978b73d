"""The executable `flexx2_camera`."""

import sys

from flexx2_sim_ros.nodes.usage import CAMERA, printed
from flexx2_sim_ros.signals import leave_on_signals


def main() -> int:
    """Run the camera node, or one in each namespace given, until told to stop."""
    if printed(CAMERA):
        return 0
    leave_on_signals(status=lambda _number: 0)  # A node that was told to stop exits with 0.
    # Imported after the signal handlers are set: it takes a second, and a signal would print a
    # traceback.
    from flexx2_sim_ros.processes import end_with_parent

    end_with_parent()
    from flexx2_sim_ros.nodes.camera_node import Flexx2Camera
    from flexx2_sim_ros.nodes.runtime import run_node

    return run_node(Flexx2Camera, several=True)


if __name__ == '__main__':
    sys.exit(main())
