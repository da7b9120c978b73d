"""Declare ROS parameters that accept the values that users type on a command line."""

import sys
from typing import Any

from flexx2_sim_ros.errors import InputError, shown, unquoted
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    *,
    read_only: bool = False,
    ignore_override: bool = False,
    any_type: bool = False,
) -> Any:
    """
    Declare a parameter and return its value.

    Parameters
    ----------
    node : rclpy.node.Node
        The node to declare it on.
    name, description : str
        For people.
    default
        A value of the parameter's type. If it is a float or a list of floats, whole numbers are
        accepted too (``-p rate:=30``).
    read_only : bool
        Whether it can be set at the start only.
    ignore_override : bool
        Whether it cannot even be set at the start.
    any_type : bool
        Whether values of every type are accepted; the caller checks them.

    Returns
    -------
    Any
        The value, of the default's type.

    Raises
    ------
    InputError
        When the value given at the start is of another type.

    """
    floats = isinstance(default, float) or (
        isinstance(default, list) and isinstance(default[0], float)
    )
    descriptor = ParameterDescriptor(
        description=description, read_only=read_only, dynamic_typing=floats or any_type
    )
    try:
        value = node.declare_parameter(name, default, descriptor, ignore_override).value
        if isinstance(default, float):
            return float(value)
        return [float(item) for item in value] if floats else value
    except (ParameterException, TypeError, ValueError) as error:
        raise InputError(
            f'{name}: must be like {default!r}, got: {unquoted(str(error), 160)}'
        ) from error


def declare_text(node: Node, name: str, default: str, description: str) -> str:
    """
    Declare a read-only text that may look like a number, and return it.

    ROS reads ``-p serial:=0123`` as the octal number 83. The text is then taken from the command
    line of this process. In a parameter file the text is lost, and the log says what to write.

    Parameters
    ----------
    node, name, default, description
        As in `declare`.

    Returns
    -------
    str

    Raises
    ------
    InputError
        When a list is given.

    """
    given = node._parameter_overrides.get(name)
    if given is None or isinstance(given.value, str):
        return str(declare(node, name, default, description, read_only=True))
    if not isinstance(given.value, bool | int | float):
        raise InputError(f'{name}: must be a text, got {shown(given.value)}')
    text = _typed(node.get_name(), name)
    if text is None:
        text = str(given.value)
        node.get_logger().warning(
            f'{name}: must be a text, got the number {text}; if something else was written, put '
            f"it in quotes, e.g. {name}: '0123'"
        )
    return str(declare(node, name, text, description, read_only=True, ignore_override=True))


def _typed(node: str, name: str) -> str | None:
    # The value of the last `-p NAME:=VALUE` or `-p NODE:NAME:=VALUE` on the command line.
    found = None
    for flag, rule in zip(sys.argv, sys.argv[1:], strict=False):
        left, _, value = rule.partition(':=')
        if flag in ('-p', '--param') and left in (name, f'{node}:{name}') and value:
            found = value
    return found
