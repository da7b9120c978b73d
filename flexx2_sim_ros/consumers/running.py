"""Run a consumer in a process of its own, which may fail, hang or end without harm to the rest."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
import os
import time
from typing import Any

from flexx2_sim_ros.consumers.consumer import CameraView, Consumer
from flexx2_sim_ros.consumers.loading import ConsumerSource, load
from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.processes import server
import numpy as np

_START_SECONDS = 600.0  # to import libraries, on a busy machine
_LARGEST_PICTURE = 200  # pixels
_LARGEST_ERROR = 1e100  # Sums of larger ones overflow.


@dataclass(frozen=True)
class ConsumerViews:
    """
    A recording as its consumers get it.

    ``true`` is the true depth of the scene, one for each pose of the camera; ``seen`` are, by
    rendition, e.g. ``real``, its images from the same poses.
    """

    name: str
    true: tuple[CameraView, ...]
    seen: dict[str, tuple[CameraView, ...]]


@dataclass
class Result:
    """
    What a consumer made of recordings.

    Attributes
    ----------
    label : str
        Its name, as far as it is known.
    title : str
        The first line of its docstring.
    measures : dict of str to str
        Units by name of an error.
    errors : list of dict
        For each recording, by rendition: its errors by name.
    pictures : list of dict
        For each recording, by rendition: an (h, w) image of errors in metres, if it makes any.
    fault : str
        Why it was given up; empty if all went well. Then the rest is not to be used.
    seconds : float
        How long it took.

    """

    label: str
    title: str = ''
    measures: dict[str, str] = field(default_factory=dict)
    errors: list[dict[str, dict[str, float]]] = field(default_factory=list)
    pictures: list[dict[str, np.ndarray]] = field(default_factory=list)
    fault: str = ''
    seconds: float = 0.0


class _FaultError(Exception):
    """The consumer cannot be used; the message says why."""


def run(
    source: ConsumerSource,
    recordings: Sequence[ConsumerViews],
    limit: float,
    step: Callable[[], None],
) -> Result:
    """
    Run a consumer on all recordings; one recording may take `limit` seconds.

    ``step`` is called after each recording.
    """
    result, began = Result(source.label), time.monotonic()
    try:
        with server(_serve, source) as connection:
            name, title, measures = _answer(connection, _START_SECONDS, 'loading')
            result.label, result.title, result.measures = name, title, measures
            for one in recordings:
                connection.send(one)
                errors, pictures = _answer(connection, limit, one.name)
                _check(errors, measures, one.name)
                _check_pictures(pictures, one.name)
                result.errors.append(errors)
                result.pictures.append(pictures)
                step()
    except _FaultError as error:
        result.fault = str(error)
    except OSError:  # The pipe is closed: the process has ended.
        result.fault = 'ended its process'
    result.seconds = round(time.monotonic() - began, 2)
    return result


def _answer(connection: Connection, limit: float, what: str) -> Any:
    if not connection.poll(limit):
        raise _FaultError(f'{what}: took longer than {limit:g} s')
    try:
        good, value = connection.recv()
    except EOFError as error:
        raise _FaultError(f'{what}: ended its process') from error
    if not good:
        raise _FaultError(f'{what}: {value}')
    return value


def _check(
    errors: Mapping[str, Mapping[str, float]], measures: Mapping[str, str], recording: str
) -> None:
    for rendition, values in errors.items():
        for key, value in values.items():
            if key not in measures:
                raise _FaultError(
                    f'{recording}: errors: must be among {", ".join(measures)}, got {shown(key)}'
                )
            if not abs(value) < _LARGEST_ERROR:
                raise _FaultError(
                    f'{recording}: {key} ({rendition}): must be a finite number below '
                    f'{_LARGEST_ERROR:g}, got {value}'
                )


def _check_pictures(pictures: Mapping[str, np.ndarray], recording: str) -> None:
    shapes = [image.shape for image in pictures.values()]
    if any(len(shape) != 2 or 0 in shape or shape != shapes[0] for shape in shapes):
        raise _FaultError(
            f'{recording}: picture: must be (h, w) of one size for all images of a recording, got '
            f'{shown(sorted(set(shapes)))}'
        )


def _serve(connection: Connection, source: ConsumerSource) -> None:
    # In the consumer's process: answers each recording with errors and pictures, until the end.
    try:
        os.dup2(2, 1)  # Standard output is the command's; this holds for libraries in C as well.
        consumer = load(source)
        title = (type(consumer).__doc__ or '').strip().partition('\n')[0][:200]
        # Plain text: the command cannot unpickle classes of the consumer's module.
        units = {str.__str__(key): str.__str__(unit) for key, unit in consumer.measures.items()}
        connection.send((True, (str.__str__(consumer.name), title, units)))
        while True:
            views = connection.recv()
            connection.send((True, judge(consumer, views)))
    except EOFError:
        return
    except BaseException as error:  # noqa: B902 - also SystemExit of the consumer
        connection.send((False, _said(error)))


def _said(error: BaseException) -> str:
    if isinstance(error, InputError):
        return str(error)
    return f'{type(error).__name__}: {unquoted(str(error))}'


def judge(
    consumer: Consumer, views: ConsumerViews
) -> tuple[dict[str, dict[str, float]], dict[str, np.ndarray]]:
    """Return a consumer's errors and pictures of a recording, by rendition, in this process."""
    true = [consumer.look(view) for view in views.true]
    errors, pictures = {}, {}
    draw = getattr(consumer, 'picture', None)
    for rendition, seen in views.seen.items():
        looks = [consumer.look(view) for view in seen]
        rows = [consumer.errors(own, real) for own, real in zip(looks, true, strict=True)]
        keys = {key for row in rows for key in row}
        errors[rendition] = {
            str(key): float(np.mean([row[key] for row in rows if key in row])) for key in keys
        }
        picture = None if draw is None else draw(looks[0], true[0])
        if picture is not None:
            pictures[rendition] = np.asarray(picture, np.float32)[
                :_LARGEST_PICTURE, :_LARGEST_PICTURE
            ]
    return errors, pictures
