"""Effects taken as given: the base simulator has them; the diagnosis looks for other effects."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from flexx2_sim_ros.effects import ageing, Effect, loadable, parse_effects
from flexx2_sim_ros.effects.tables import PixelMap
from flexx2_sim_ros.effects.time_offset import changing
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.frame_state import FrameState

Table = Mapping[str, Mapping[str, Any]]


def given_effects(known: Table, uptime: float | None = None) -> tuple[Effect, ...]:
    """
    Return the effects that the base simulator has, in the order of light.

    A `TimeOffset` that only delays images is left out: it changes none of them, and says nothing
    of their latency. `known` has parameters by effect; `uptime` is a recording's time since
    power-on, seconds, effects keep their own if None. Raises `InputError` when an effect or a
    parameter cannot be used, or is a pose error.
    """
    table = {name: dict(values) for name, values in known.items()}
    if uptime is not None:
        for name in ageing(table):
            table[name]['uptime'] = uptime
    effects: tuple[Effect, ...] = changing(parse_effects(table, 'known'))
    for effect in effects:
        if effect.role == 'pose':
            raise InputError(
                f'known: must be effects of the camera, got {effect.name}: correct the poses of '
                'the recordings'
            )
    return effects


def at_size(known: Table, height: int, width: int) -> Table:
    """
    Return given effects for images of another size in pixels, in which a camera is simulated.

    `known` has parameters by effect, maps as `PixelMap`.
    """
    return {
        name: {
            key: one.at_size(height, width) if isinstance(one, PixelMap) else one
            for key, one in values.items()
        }
        for name, values in known.items()
    }


def together(given: tuple[Effect, ...], effects: Any) -> tuple[Effect, ...]:
    """
    Return effects of a simulation with those that are given, in the order of light.

    `given` is from `given_effects`; `effects`, a mapping or an iterable of `Effect`, is what the
    simulation adds. A bias or a factor on sigma_z that is given as well counts twice: the biases
    are added, the factors multiplied. With a curve, one acts after the other; such a pair has no
    settings of its own (`in_one_table`).
    """
    if isinstance(effects, Mapping):
        effects = parse_effects(effects)
    by_name = {effect.name: effect for effect in given}
    for effect in effects:
        other = by_name.get(effect.name)
        by_name[effect.name] = effect if other is None else _both(other, effect)
    return tuple(by_name[name] for name in loadable() if name in by_name)


def in_one_table(given: tuple[Effect, ...], effects: Any) -> dict[str, dict[str, Any]]:
    """
    Return the settings of what `together` returns, by effect.

    Raises `InputError` when an effect is in both, unless it is a bias or a factor on sigma_z
    without a curve.
    """
    both = together(given, effects)
    for one in both:
        if isinstance(one, _InTurn):
            raise InputError(
                'known: must not have an effect that is looked for as well where one of them has '
                f'a curve, got {one.name}'
            )
    return {one.name: one.settings for one in both}


class _InTurn:
    """Mark of an effect that stands for two of its kind."""


def _both(one: Effect, other: Effect) -> Effect:
    if one.role not in ('bias', 'sigma'):
        raise InputError(
            f'known: must not have an effect that is looked for as well, got {one.name}'
        )
    if one.forms or other.forms:
        return _in_turn(one, other)
    (name,) = (p.name for p in one.parameters() if p.name != 'strength')
    a, b = (getattr(effect, name) for effect in (one, other))
    if one.role == 'bias':
        return replace(other, strength=1.0, **{name: one.strength * a + other.strength * b})
    factor = (1 + one.strength * (a - 1)) * (1 + other.strength * (b - 1))
    return replace(other, strength=1.0, **{name: factor})


def _in_turn(one: Effect, other: Effect) -> Effect:
    # A number is of depth, a curve along the ray or over another quantity: they have no sum.
    def apply(self: Effect, state: FrameState) -> None:
        one.apply(state)
        other.apply(state)

    kind: Any = type('InTurn', (_InTurn, type(one)), {'apply': apply})
    return kind(strength=1.0)
