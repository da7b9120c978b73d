"""The messages of a page, decoded and checked."""

from dataclasses import dataclass
import json
import math

from flexx2_sim_ros.errors import InputError, shown

# In characters. Camera names are ROS names, modes are shorter.
_LONGEST_NAME = 256


@dataclass(frozen=True)
class Drawn:
    """
    A page has drawn a frame.

    Attributes
    ----------
    camera : str
        Its name.

    """

    camera: str


@dataclass(frozen=True)
class Drive:
    """
    A page drives the robot.

    Attributes
    ----------
    velocity : tuple of float
        Forward and to the left in m/s, turn to the left in rad/s; finite; zeros stop.

    """

    velocity: tuple[float, float, float]


@dataclass(frozen=True)
class Choose:
    """
    A page requests a mode.

    Attributes
    ----------
    camera : str
        Its name.
    usecase : str
        The mode, printable.

    """

    camera: str
    usecase: str


@dataclass(frozen=True)
class Adjust:
    """
    A page requests the strength of an effect.

    Attributes
    ----------
    camera : str
        Its name.
    effect : str
        The effect, printable.
    strength : float
        Finite; the camera's node refuses what it cannot take.

    """

    camera: str
    effect: str
    strength: float


def parse(message: str | bytes) -> Drawn | Drive | Choose | Adjust:
    """
    Decode a websocket's message.

    Raises
    ------
    InputError
        When it is not a message of the page. The text has one line.

    """
    try:
        match json.loads(message) if isinstance(message, str) else None:
            case {'drawn': str(camera)} if _is_name(camera):
                return Drawn(camera)
            case {'drive': [x, y, turn]}:
                return Drive((_number(x), _number(y), _number(turn)))
            case {'usecase': [str(camera), str(usecase)]} if _is_name(camera) and _is_name(
                usecase
            ):
                return Choose(camera, usecase)
            case {'effect': [str(camera), str(effect), strength]} if _is_name(camera) and _is_name(
                effect
            ):
                return Adjust(camera, effect, _number(strength))
    # Raised for deep nesting, and for whole numbers too large for a float.
    except (ValueError, RecursionError, OverflowError):
        pass
    raise InputError(f'message: must be JSON as the page sends it, got {shown(message)}')


def _is_name(text: str) -> bool:
    return len(text) <= _LONGEST_NAME and text.isprintable()


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError
    number = float(value)
    if not math.isfinite(number):
        raise ValueError
    return number
