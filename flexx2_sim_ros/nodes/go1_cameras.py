"""The executable `go1_cameras`."""

import sys

from flexx2_sim_ros.errors import missing_library
from flexx2_sim_ros.nodes.usage import printed, ROBOT
from flexx2_sim_ros.signals import leave_on_signals


def main() -> int:
    """Run the robot node until it is told to stop."""
    if printed(ROBOT):
        return 0
    leave_on_signals(status=lambda _number: 0)  # A node that was told to stop exits with 0.
    # Imported after the signal handlers are set: it takes a second, and a signal would print a
    # traceback.
    from flexx2_sim_ros.processes import end_with_parent

    end_with_parent()
    try:
        from flexx2_sim_ros.nodes.robot_node import RobotCameras
        from flexx2_sim_ros.nodes.runtime import run_node
    except ModuleNotFoundError as error:
        print(f'error: {missing_library(error)}', file=sys.stderr)
        return 1
    return run_node(RobotCameras)


if __name__ == '__main__':
    sys.exit(main())
