"""
Declare ROS parameters that accept what users type, and that files of ROS keep as they are.

A file of ``ros2 param dump`` is read by ``--params-file`` or by ``ros2 param load``. These make
another type of some texts: 83 of ``0123``, true of ``y``, 1000 of ``1e3``. A text that is given
as another type is taken as its text; a text that would come back as another one is refused.
"""

from contextlib import suppress
import math
import re
import sys
from typing import Any

from flexx2_sim_ros.errors import InputError, one_sentence, shown, unquoted
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import get_parameter_value, Parameter
import yaml

# What --params-file reads as a number or a truth value where it has no quotes, as strtod of C.
_NO_TEXT = re.compile(
    r'[+-]?(0x([0-9a-f]+\.?[0-9a-f]*|\.[0-9a-f]+)(p[+-]?\d+)?|(\d+\.?\d*|\.\d+)(e[+-]?\d+)?'
    r'|inf(inity)?|nan(\(\w*\))?)|[yn]',
    re.ASCII | re.IGNORECASE,
)
_SAME_AGAIN = 'nan', 'inf', '-inf'  # numbers whose text is what was written


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    *,
    read_only: bool = False,
    ignore_override: bool = False,
) -> Any:
    """
    Declare a parameter and return its value, of the default's type.

    If the default is a float or a list of floats, whole numbers are accepted too (``-p
    rate:=30``); if it is a text, whatever looks like another type. A ``read_only`` parameter can
    be set at the start only, with ``ignore_override`` not even then. Raises InputError when the
    value given at the start is of another type, or a text that a file does not keep.
    """
    if isinstance(default, str):
        text = default if ignore_override else _given_text(node, name, default)
        _check_text(name, text, read_only)
        descriptor = ParameterDescriptor(description=description, read_only=read_only)
        return node.declare_parameter(name, text, descriptor, ignore_override=True).value
    floats = isinstance(default, float) or (
        isinstance(default, list) and isinstance(default[0], float)
    )
    descriptor = ParameterDescriptor(
        description=description, read_only=read_only, dynamic_typing=floats
    )
    try:
        value = node.declare_parameter(name, default, descriptor, ignore_override).value
        if isinstance(default, float):
            return float(value)
        if floats:
            return [float(item) for item in value]
    except (ParameterException, TypeError, ValueError) as error:
        raise InputError(
            f'{name}: must be like {default!r}, got: {unquoted(str(error), 160)}'
        ) from error
    for item in value if isinstance(default, list) else ():
        _check_text(name, item, True, among_texts=True)
    return value


def as_declared(name: str, value: Any, now: Any) -> Any:
    """
    Return a new value of a parameter that can change, as the type of its present value, `now`.

    It is unchanged if it cannot be of this type; rclpy says so. Raises InputError when it is a
    text that a file does not keep.
    """
    if isinstance(now, str):
        text = _as_text(value)
        if text is None:
            return value
        text = text.strip()  # ROS does not keep spaces around a text.
        _check_text(name, text)
        return text
    if isinstance(now, float) and isinstance(value, int | str) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            return float(value)
    return value


def as_loaded(value: Any) -> Any:
    """
    Return what ``ros2 param load`` makes of a value in a file.

    Raises InputError when it ends with an error.
    """
    with one_sentence('ros2 param load cannot read it'):
        message = ParameterMessage(value=get_parameter_value(str(value)))
        return Parameter.from_parameter_msg(message).value


def _as_text(value: Any) -> str | None:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, str | int | float) else None


def _check_text(name: str, text: str, fixed: bool = False, *, among_texts: bool = False) -> None:
    # `ros2 param load` does not set a fixed one, but must get beyond it.
    kept = (
        not _NO_TEXT.fullmatch(text)
        or not yaml.safe_dump(text).startswith(text)  # in quotes
        or (text in _SAME_AGAIN and not among_texts)
    )
    try:
        loaded = as_loaded(text)
    except InputError:
        kept = False
    if not kept or not (fixed or _as_text(loaded) == text):
        raise InputError(
            f'{name}: must be a text that `ros2 param dump` and `load` keep as it is, got '
            f'{shown(text)}'
        )


def _given_text(node: Node, name: str, default: str) -> str:
    # ROS reads `-p serial:=0123` as the octal number 83: the command line of this process has the
    # text. In a parameter file it is lost, and the log says what to write.
    given = node._parameter_overrides.get(name)
    value = default if given is None else given.value
    text = _as_text(value)
    if text is None:
        raise InputError(f'{name}: must be a text, got {shown(value)}')
    if isinstance(value, str) or not math.isfinite(value):
        return text
    typed = _typed(node.get_name(), name)
    if typed is None:
        node.get_logger().warning(
            f'{name}: must be a text, got {text}; if something else was written, put it in '
            f"quotes, e.g. {name}: '0123'"
        )
    return typed or text


def _typed(node: str, name: str) -> str | None:
    # The value of the last `-p NAME:=VALUE` or `-p NODE:NAME:=VALUE` on the command line.
    found = None
    for flag, rule in zip(sys.argv, sys.argv[1:], strict=False):
        left, _, value = rule.partition(':=')
        if flag in ('-p', '--param') and left in (name, f'{node}:{name}') and value:
            found = value
    return found
