"""Two nodes of one name would publish on the same topics: the second one is not to start."""

import socket
import sys

from flexx2_sim_ros.errors import InputError
from rclpy.node import Node


def twin_text(node: Node) -> str:
    """Return what to say when there is another node of this one's name."""
    return (
        f'node name: must be unique, got {node.get_fully_qualified_name()}, which is running '
        'already. Choose another name or namespace, e.g. --ros-args -r __node:=another'
    )


def take(node: Node, name: str) -> socket.socket | None:
    """
    Take a name in the node's ROS domain for this process, at once.

    What is taken is a socket's name without a file, which Linux gives free when the process ends,
    however it ends. Elsewhere nothing is taken.

    Returns
    -------
    socket.socket or None
        To be kept, and closed to give the name free.

    Raises
    ------
    OSError
        When it is taken.

    """
    if sys.platform != 'linux':
        return None
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    whole = f'ros/{node.context.get_domain_id()}{name}'
    try:
        # At most 108 bytes: the end of a name is what differs.
        claim.bind('\0' + whole[-100:])
    except OSError:
        claim.close()
        raise
    return claim


def claim_name(node: Node) -> socket.socket | None:
    """
    Take a node's name on this machine, at once: in the graph a twin takes up to 3 s to appear.

    Returns
    -------
    socket.socket or None
        To be kept while the node runs.

    Raises
    ------
    InputError
        When another process has it.

    """
    try:
        return take(node, node.get_fully_qualified_name())
    except OSError as error:
        raise InputError(twin_text(node)) from error
