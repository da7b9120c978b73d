"""Prevent two nodes of the same name: they would publish on the same topics."""

import socket
import sys

from flexx2_sim_ros.errors import InputError
from rclpy.node import Node


def twin_text(node: Node) -> str:
    """Return the error for a second node of the same name."""
    return (
        f'node name: must be unique, got {node.get_fully_qualified_name()}, which is running '
        'already. Choose another name or namespace, e.g. --ros-args -r __node:=another'
    )


def take(node: Node, name: str) -> socket.socket | None:
    """
    Claim a name in the node's ROS domain for this process.

    The claim is an abstract socket name, which Linux releases when the process ends, even after a
    crash. On other systems nothing is claimed. The socket must be kept; closing it releases the
    name. Raises OSError when the name is claimed.
    """
    if sys.platform != 'linux':
        return None
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    whole = f'ros/{node.context.get_domain_id()}{name}'
    try:
        # At most 108 bytes: names differ at their end.
        claim.bind('\0' + whole[-100:])
    except OSError:
        claim.close()
        raise
    return claim


def claim_name(node: Node) -> socket.socket | None:
    """
    Claim a node's name on this machine: in the graph, a second node appears only after 3 s.

    The socket must be kept while the node runs. Raises InputError when another process has claimed
    it.
    """
    try:
        return take(node, node.get_fully_qualified_name())
    except OSError as error:
        raise InputError(twin_text(node)) from error
