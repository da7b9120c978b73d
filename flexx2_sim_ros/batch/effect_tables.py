"""The numbers of effects' formulas, one row for each environment, as Warp's kernels read them."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

from flexx2_sim_ros.camera import Camera, Mode, Profile
from flexx2_sim_ros.effects import Effect, registry
from flexx2_sim_ros.effects.range_wrap import lattice_step, noise_shares
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.frame_state import check_frequencies, FrameState, Memory
from flexx2_sim_ros.physics.lateral import edge_limit, pixel_sigma
import numpy as np
import warp as wp

# Effects with a formula in the kernels.
BATCHED = tuple(name for name, kind in registry().items() if kind.batched is not None)
MOST_FREQUENCIES = 3


def _parameters() -> Any:
    names = [
        f'{name}_{number}'
        for name in BATCHED
        for number in {'strength': 0.0, **registry()[name]().constants()}
    ]
    return type(
        'Effects',
        (),
        {'__annotations__': dict.fromkeys(names, wp.float32), '__module__': __name__},
    )


# Of each effect `Effect.constants` and its strength, 0 for off: `offset_strength`, ...
Effects = wp.struct(_parameters())


@wp.struct
class Light:
    """What effects need to know of an environment's mode; of its frequencies up to three."""

    frequencies: wp.int32
    turns: wp.vec3f  # of phase a metre of depth
    weights: wp.vec3f
    spans: wp.vec3f
    spreads: wp.vec3f
    steps: wp.vec3f  # of the lattice of the frequencies 0 and 1, 0 and 2, 1 and 2
    ambiguity: wp.float32
    acquisition: wp.float32


def each_environment(effects: Any, num_envs: int) -> list[tuple[Effect, ...]]:
    """
    Return the effects that are on in each of N environments.

    `effects` are what `Camera` takes, for all environments, or a sequence of N such. Raises
    InputError for effects that `Camera` does not take.
    """
    several = (
        isinstance(effects, Sequence)
        and not isinstance(effects, str)
        and effects
        and all(isinstance(one, str | PathLike | Mapping | tuple | list) for one in effects)
    )
    if not several:
        return [_checked(effects)] * num_envs
    if len(effects) != num_envs:
        raise InputError(
            f'effects: must be one set, or one for each of the {num_envs} environments, got '
            f'{len(effects)}'
        )
    read: dict[int, tuple[Effect, ...]] = {}
    for one in effects:
        if id(one) not in read:
            read[id(one)] = _checked(one)
    return [read[id(one)] for one in effects]


def _checked(effects: Any) -> tuple[Effect, ...]:
    return Camera(effects=effects).effects  # type: ignore[return-value]


def effects_row(effects: Sequence[Effect]) -> np.ndarray:
    """Return the row of an environment, of `Effects`; all else is off."""
    row: Any = np.zeros((), np.dtype(Effects.numpy_dtype()))
    for effect in effects:
        for name, number in {'strength': effect.strength, **effect.constants()}.items():
            row[f'{effect.name}_{name}'] = number
    return row


def noise_row(mode: Mode, effects: Sequence[Effect]) -> tuple[float, ...]:
    """Return the row of an environment, of `frame.Noise`, or raise `InputError`."""
    check_frequencies(effects, mode)
    noise, edge_sigma, laplace = mode.noise, mode.noise.sigma_x, 0.0
    for effect in effects:
        if 'edges' in (effect.batched or ()):
            edge_sigma, laplace = effect.edges(edge_sigma)  # type: ignore[attr-defined]
    return (
        noise.a,
        noise.b,
        noise.c,
        noise.d,
        noise.n,
        mode.range_min,
        mode.range_max,
        pixel_sigma(edge_sigma),
        laplace,
        edge_limit(edge_sigma, laplace),
    )


def light_row(mode: Mode, profile: Profile) -> np.ndarray:
    """Return the row of an environment, of `Light`; one of weight 1 if none is known."""
    row: Any = np.zeros((), np.dtype(Light.numpy_dtype()))  # type: ignore
    count = len(mode.modulation_hz)
    if not count:
        row['frequencies'], row['weights'][0] = 1, 1.0
    if not 0 < count <= MOST_FREQUENCIES:
        return row
    nothing = np.zeros((1, 1), np.float32)
    state = FrameState(
        mode, profile.intrinsics, 0, np.zeros(2, np.uint32), Memory(), nothing, nothing
    )
    frequencies = mode.modulation_hz
    row['frequencies'] = count
    row['turns'][:count] = np.array(state.wave_numbers) / (2 * np.pi)
    row['weights'][:count] = state.weights
    row['spans'][:count] = state.spans
    row['spreads'][:count] = noise_shares(frequencies)
    for place, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        if j < count:
            row['steps'][place] = lattice_step(frequencies[i], frequencies[j])
    row['ambiguity'] = state.ambiguity
    row['acquisition'] = state.acquisition_seconds
    return row
