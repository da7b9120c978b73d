"""The executable `flexx2_camera`."""

import sys

from flexx2_sim_ros.signals import leave_on_signals


def main() -> int:
    """Run the camera node until it is told to stop."""
    leave_on_signals(status=lambda _number: 0)  # As a node that was told to end.
    # Imported here, since it takes a second in which a signal would leave a traceback.
    from flexx2_sim_ros.processes import end_with_parent

    end_with_parent()
    from flexx2_sim_ros.nodes.camera_node import Flexx2Camera
    from flexx2_sim_ros.nodes.runtime import run_node

    return run_node(Flexx2Camera)


if __name__ == '__main__':
    sys.exit(main())
