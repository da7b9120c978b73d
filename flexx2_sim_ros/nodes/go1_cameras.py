"""The executable `go1_cameras`."""

import sys

from flexx2_sim_ros.nodes.runtime import leave_at_once_on_signals, run_node


def main() -> int:
    """Run the Go1 node until it is told to stop."""
    leave_at_once_on_signals()
    # Imported here, since it takes a second in which a signal would leave a traceback.
    from flexx2_sim_ros.nodes.go1_node import Go1Cameras
    return run_node(Go1Cameras)


if __name__ == '__main__':
    sys.exit(main())
