"""Declare ROS parameters so that what is typed on a command line is understood."""

from typing import Any

from flexx2_sim_ros.errors import InputError
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node


def declare(node: Node, name: str, default: Any, description: str, *, read_only: bool = False,
            ignore_override: bool = False, any_type: bool = False) -> Any:
    """
    Declare a parameter and return its value.

    Parameters
    ----------
    node : rclpy.node.Node
        The node to declare it on.
    name, description : str
        For people.
    default
        A value of the parameter's type. Where it is a float (or a list of them), whole numbers
        are taken as well: ``-p rate:=30`` is what people type.
    read_only : bool
        Whether it can be set at the start only.
    ignore_override : bool
        Whether it cannot even be set at the start.
    any_type : bool
        Whether values of every type are taken, for the caller to check.

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
        isinstance(default, list) and isinstance(default[0], float))
    descriptor = ParameterDescriptor(description=description, read_only=read_only,
                                     dynamic_typing=floats or any_type)
    try:
        value = node.declare_parameter(name, default, descriptor, ignore_override).value
        if isinstance(default, float):
            return float(value)
        return [float(item) for item in value] if floats else value
    except (ParameterException, TypeError, ValueError) as error:
        raise InputError(f'{name}: {error}; wanted something like {default!r}') from error
