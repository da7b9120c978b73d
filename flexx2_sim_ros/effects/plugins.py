"""
Effects of other packages: entry points of the group ``flexx2_sim_ros.effects``.

A plug-in that cannot be used is named in one line and left out; all else goes on. What it cannot
be kept from is ending or blocking the process from within its own code.
"""

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import wraps
import logging
import math
import re
from typing import Any

from flexx2_sim_ros.effects.effect import CHANNELS, COVARIATES, Effect, NUISANCES, stream_of
from flexx2_sim_ros.effects.hypothesis import Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.ray import AlongRay
from flexx2_sim_ros.effects.tables import Table
from flexx2_sim_ros.entry_points import entry_points
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.frame_state import FrameState, Memory, Stage
from flexx2_sim_ros.physics.surface import analyse
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import DEFAULT_USECASE, flexx2
import numpy as np

GROUP = 'flexx2_sim_ros.effects'
_NAME = re.compile(r'[a-z][a-z0-9_]{0,39}')
_LONGEST = 80
_IMAGES = ('depth', 'amplitude', 'sigma', 'normals', 'cosine', 'measured')
_log = logging.getLogger(__name__)
_broken: set[str] = set()


def plug_ins(taken: Collection[str]) -> list[type[Effect]]:
    """
    Load the effects of other packages that can be used; a warning names each other one.

    ``taken`` are the names that there are already.
    """
    found: list[type[Effect]] = []
    names = set(taken)
    points = list(entry_points(GROUP, _leave_out))
    if points:
        # numba reads all entry points when it first compiles. A ruined one makes it raise once:
        # here, so that it is not taken for a fault of the first plug-in.
        with suppress(Exception):
            _small_frame(Memory(), 0, Stage.DROPOUT)
    for point in points:
        try:
            kind = _checked(point.load(), names)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: B902 - SystemExit, too
            _leave_out(point.name, error)
            continue
        setattr(kind, 'apply', _guarded(kind.apply))  # noqa: B010 - a method
        found.append(kind)
        names.add(kind.name)
    return found


def _leave_out(name: str, error: BaseException) -> None:
    _log.warning('effects: plug-in %s is left out: %s', _shown(name), _said(error))


def _said(error: BaseException) -> str:
    kind = type(error).__name__
    try:
        # What is refused here is in words of our own, with little of the plug-in's in it.
        own = isinstance(error, InputError)
        return _shown(str(error), 4 * _LONGEST) if own else f'{kind}: {_shown(str(error))}'
    except Exception:
        return kind


def _shown(text: str, longest: int = _LONGEST) -> str:
    # In one line, not too long, without control characters.
    plain = ''.join(c if c.isprintable() else repr(c)[1:-1] for c in text[:longest])
    return plain[:longest] + ('...' if len(text) > longest else '')


def _checked(kind: Any, taken: Collection[str]) -> type[Effect]:
    # The definition, if everything in it can be used.
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise InputError(f'must be a subclass of Effect, got {kind!r:.80}')
    if not is_dataclass(kind) or '__dataclass_fields__' not in vars(kind):
        raise InputError('must be a frozen dataclass')
    name = getattr(kind, 'name', None)
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise InputError(f'name: must be an identifier in lower case, got {name!r:.80}')
    if name in taken:
        raise InputError(f'name: must be one that is not taken, got {name!r}')
    _check_attributes(kind)
    _check_parameters(kind)
    _check_hypotheses(kind)
    _try_out(kind)
    return kind


def _check_attributes(kind: type[Effect]) -> None:
    wanted: dict[str, tuple[Callable[[Any], bool], str]] = {
        'stage': (lambda x: isinstance(x, Stage), 'a Stage'),
        'order': (lambda x: isinstance(x, int), 'a whole number'),
        'title': (_is_text, 'a text of one line'),
        'source': (_is_text, 'a text of one line'),
        'family': (lambda x: x == '' or _is_text(x), 'a text of one line'),
        'covariate': (lambda x: x in COVARIATES, f'one of {", ".join(COVARIATES)}'),
        'changes': (lambda x: _are_some(x, CHANNELS), f'some of {", ".join(CHANNELS)}'),
        'nuisances': (lambda x: _are_some(x, NUISANCES), f'some of {", ".join(NUISANCES)}'),
        'picture': (lambda x: isinstance(x, Picture), 'a Picture'),
        'brightness': (_is_size, 'a number from 0'),
        'doubt': (_is_size, 'a number from 0'),
        'stream': (lambda x: x == stream_of(kind.name), 'left to be derived from the name'),
        # What follows is for the effects of this package.
        'listed': (lambda x: x is True, 'True'),
        'role': (lambda x: x == '', 'empty'),
        'reads_as': (lambda x: x == (), 'empty'),
        'batched': (lambda x: x is None, 'None'),
    }
    for name, (good, text) in wanted.items():
        value = getattr(kind, name, None)
        if not good(value):
            raise InputError(f'{name}: must be {text}, got {value!r:.80}')


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value.strip()) and value.isprintable()


def _is_size(value: Any) -> bool:
    return isinstance(value, int | float) and 0 <= value < math.inf


def _are_some(value: Any, known: Collection[str]) -> bool:
    return isinstance(value, tuple) and set(value) <= set(known)


def _check_parameters(kind: type[Effect]) -> None:
    for one in fields(kind):
        if isinstance(one.metadata.get('table'), Table):
            continue
        bounds = [one.default, *(one.metadata.get(key) for key in ('low', 'high'))]
        if not all(isinstance(x, int | float) and math.isfinite(x) for x in bounds):
            raise InputError(f'{one.name:.80}: must be made by parameter(...) of numbers')
        texts = [one.metadata.get(key) for key in ('unit', 'text')]
        if not (texts[0] == '' or _is_text(texts[0])) or not _is_text(texts[1]):
            raise InputError(f'{one.name:.80}: unit and text must be texts of one line')
        if not _NAME.fullmatch(one.name.lower()):
            raise InputError(f'parameter: must be an identifier, got {one.name!r:.80}')
    if kind.parameters()[0] != Effect.parameters()[0]:
        raise InputError('strength: must be left as it is')
    kind()  # complains about typical values out of bounds


def _check_hypotheses(kind: type[Effect]) -> None:
    names = {item.name for item in kind.parameters()}
    if not isinstance(kind.hypotheses, tuple) or not all(
        isinstance(one, Hypothesis) for one in kind.hypotheses
    ):
        raise InputError('hypotheses: must be a tuple of Hypothesis')
    for one in kind.hypotheses:
        if one.label != '' and not _is_text(one.label):
            raise InputError(
                f'hypotheses: label must be a text of one line, got {one.label!r:.80}'
            )
        kind.from_mapping(dict(one.fixed))
        for term in one.terms:
            if term.stand_in is not None or not term.values or not term.low < term.high:
                raise InputError(f'hypotheses: {term.name:.80}: must have values and bounds')
            for value in (*term.values, term.low, term.high):
                kind.from_mapping({**one.fixed, **term.fixed, term.name: value})
            if term.along_ray:
                AlongRay.from_mapping({term.along_ray: 0.0})
    for values in kind.like_a_pose:
        kind.from_mapping(dict(values))
    for name in (kind.compared, kind.lattice):
        if name not in {'', *names}:
            raise InputError(f'compared, lattice: must be a parameter, got {name!r:.80}')


def _try_out(kind: type[Effect]) -> None:
    memory = Memory()
    for stamp in (0, 33_333_333):
        memory.begin(stamp)
        _run(kind(), kind.apply, _small_frame(memory, stamp, kind.stage))


def _small_frame(memory: Memory, stamp: int, stage: Stage) -> FrameState:
    # A slanted wall, with the images that there are at a stage.
    mode = flexx2().mode(DEFAULT_USECASE)
    camera = Intrinsics.from_field_of_view(16, 12, 56.0, 44.0)
    wall = np.linspace(1.0, 1.2, 192, dtype=np.float32).reshape(12, 16)
    half = np.full_like(wall, 0.5)
    key = np.array([1, 2], np.uint32)
    state = FrameState(mode, camera, stamp, key, memory, wall, half)
    if stage > Stage.GEOMETRY:
        state.surface, state.amplitude = analyse(wall, camera, mode.sensor), half.copy()
        state.cosine = state.surface.cos_incidence.copy()
    if stage > Stage.AMPLITUDE:
        state.shifts = [np.zeros_like(wall) for _ in mode.modulation_hz]
    if stage > Stage.PHASOR:
        state.sigma, state.normals = half * np.float32(0.01), half.copy()
    if stage > Stage.NOISE:
        state.measured = wall.copy()
    return state


def _guarded(apply: Callable[[Any, FrameState], None]) -> Callable[[Any, FrameState], None]:
    # Once it has failed, it is off for good.
    @wraps(apply)
    def guarded(self: Effect, state: FrameState) -> None:
        if self.name in _broken:
            return
        try:
            _run(self, apply, state)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: B902 - SystemExit, too
            _broken.add(self.name)
            _leave_out(self.name, error)

    return guarded


def _run(effect: Effect, apply: Callable[[Any, FrameState], None], state: FrameState) -> None:
    # On copies, so that the frame is as it was if anything is wrong.
    images: dict[str, Any] = {}
    for name in (*_IMAGES, 'reflectivity'):
        image = getattr(state, name)
        images[name] = None if image is None else image.copy()
    trial = replace(state, **images, shifts=[shift.copy() for shift in state.shifts])
    apply(effect, trial)
    shape = state.depth.shape
    out = {
        name: _image(name, getattr(trial, name), [shape])
        for name in _IMAGES
        if getattr(trial, name) is not None
    }
    out['reflectivity'] = _image('reflectivity', trial.reflectivity, [shape, (1, 1)])
    if len(trial.shifts) != len(state.shifts):
        raise InputError(f'shifts: must be {len(state.shifts)} images, got {len(trial.shifts)}')
    shifts = [_image('shifts', shift, [shape]) for shift in trial.shifts]
    edges = float(trial.edge_sigma), float(trial.edge_laplace)
    if not (0 <= edges[0] < 1e3 and 0 <= edges[1] <= 1):
        raise InputError(f'edge_sigma, edge_laplace: must be sizes, got {edges}')
    saturated = trial.saturated
    if saturated is not None and (saturated.dtype != bool or saturated.shape != shape):
        raise InputError(f'saturated: must be bool of shape {shape}')
    for name, image in out.items():
        setattr(state, name, image)
    state.shifts, state.saturated = shifts, saturated
    state.edge_sigma, state.edge_laplace = edges


def _image(name: str, value: Any, shapes: list[tuple[int, ...]]) -> np.ndarray:
    image = np.ascontiguousarray(value, np.float32)
    if image.shape not in shapes:
        raise InputError(f'{name}: must have shape {shapes[0]}, got {image.shape}')
    return image
