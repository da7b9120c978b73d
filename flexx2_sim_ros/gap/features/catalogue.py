"""The effects that a gap is explained with: what is simulated of each, and how it is combined."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

from flexx2_sim_ros.effects.registry import loadable

Table = dict[str, dict[str, float]]

DRIFT_TAUS = (300.0, 900.0, 2700.0)
_RAY = 'along the ray '
NEEDS_MOTION = frozenset({'motion_artefact', 'time_offset'})


@dataclass(frozen=True)
class Term:
    """
    One parameter of a candidate.

    Attributes
    ----------
    name : str
        For people.
    nodes : tuple of (float, str)
        Values at which the shift of all features was simulated, and the column's name; between
        them and zero it is interpolated, beyond them extrapolated.
    low, high : float
        Bounds of the value.
    neutral : float
        Value at which nothing is changed.

    """

    name: str
    nodes: tuple[tuple[float, str], ...]
    low: float
    high: float
    neutral: float = 0.0


@dataclass(frozen=True)
class Candidate:
    """
    An effect in one of its variants.

    Attributes
    ----------
    effect, label : str
        The effect's name; which variant.
    terms : tuple of Term
    build : callable
        From the terms' values to the effect's parameters.
    given : Candidate or None
        What stands for it in the outcome: phase is measured along the ray, the catalogue's effects
        act along the optical axis. An effect is recognised in either form, and given in the
        catalogue's, fitted as that.

    """

    effect: str
    label: str
    terms: tuple[Term, ...]
    build: Callable[[tuple[float, ...]], dict[str, float]]
    given: 'Candidate | None' = None


@dataclass(frozen=True)
class Column:
    """
    A simulation to make: effects, and whether a few frames are enough.

    Attributes
    ----------
    name : str
    effects : dict
        Parameters by effect.
    few : bool

    """

    name: str
    effects: Table
    few: bool = True


def catalogue(
    without: Collection[str] = (), modulation: bool = True
) -> tuple[list[Column], list[Candidate]]:
    """
    Return what to simulate and what to explain a gap with.

    Parameters
    ----------
    without : collection of str
        Effects to leave out.
    modulation : bool
        Whether the modulation frequencies are known; if not, effects that need them are left
        out.

    """
    columns: dict[str, Column] = {}
    candidates: list[Candidate] = []

    def nodes(
        effect: str, name: str, values: tuple[float, ...], few: bool = True, **fixed: float
    ) -> tuple[tuple[float, str], ...]:
        out = []
        for value in values:
            tag = ','.join(f'{k}={v:g}' for k, v in {**fixed, name: value}.items())
            key = f'{effect}:{tag}'
            columns[key] = Column(key, {effect: {**fixed, name: value}}, few)
            out.append((value, key))
        return tuple(out)

    def one(
        effect: str,
        name: str,
        values: tuple[float, ...],
        low: float,
        high: float,
        label: str = '',
        few: bool = True,
        **fixed: float,
    ) -> None:
        if effect not in without:
            term = Term(
                name,
                nodes(effect, name, values, few, **fixed),
                low,
                high,
                1.0 if name == 'factor' else 0.0,
            )
            candidates.append(Candidate(effect, label, (term,), lambda x: {**fixed, name: x[0]}))

    def along_ray(names: Sequence[str]) -> None:
        # The last candidate once more, along the ray; terms of these names differ.
        axial = candidates[-1]
        terms = tuple(
            term
            if term.name not in names
            else Term(
                term.name,
                tuple((value, _RAY + column) for value, column in term.nodes)
                if axial.effect == 'warm_up_drift'
                else nodes(
                    'along_ray',
                    {'intercept': 'bias'}.get(term.name, term.name),
                    tuple(value for value, _ in term.nodes),
                ),
                term.low,
                term.high,
            )
            for term in axial.terms
        )
        candidates.append(
            Candidate(
                axial.effect, f'{axial.label} along the ray'.strip(), terms, axial.build, axial
            )
        )

    # One node: of a large bias the pose takes most, so that what is left is small, and linear.
    bias = nodes('offset', 'bias', (0.005,))
    nodes('along_ray', 'bias', (0.005,))
    one('offset', 'bias', (0.005,), -0.1, 0.1)
    if 'offset' not in without:
        along_ray(['bias'])
    if 'wiggling' not in without:
        for label, names in (
            ('fourth harmonic', ('a4', 'b4')),
            ('first harmonic', ('a1', 'b1')),
            ('two harmonics', ('a1', 'b1', 'a2', 'b2')),
            ('four harmonics', ('a1', 'b1', 'a2', 'b2', 'a3', 'b3', 'a4', 'b4')),
        ):
            terms = tuple(
                Term(
                    name,
                    nodes(
                        'wiggling', name, (0.004,), True, **({} if name == 'a4' else {'a4': 0.0})
                    ),
                    -0.05,
                    0.05,
                )
                for name in names
            )
            candidates.append(Candidate('wiggling', label, terms, _named({'a4': 0.0}, *names)))
            along_ray(names)
    if 'warm_up_drift' not in without:
        for tau in DRIFT_TAUS:
            term = Term('bias', ((0.010, f'drift:{tau:g}'),), -0.1, 0.1)
            candidates.append(
                Candidate('warm_up_drift', f'{tau:g} s', (term,), _named({'tau': tau}, 'bias'))
            )
            along_ray(['bias'])
    if 'amplitude_bias' not in without:
        for knee, span in ((0.1, 3.0), (0.4, 3.0), (1.0, 3.0), (3.0, 5.0)):
            terms = (
                Term('intercept', bias, -0.05, 0.05),
                Term(
                    'slope',
                    nodes('amplitude_bias', 'slope', (-0.003,), knee=knee, span=span),
                    -0.05,
                    0.05,
                ),
            )
            candidates.append(
                Candidate(
                    'amplitude_bias',
                    f'knee {knee:g}',
                    terms,
                    _named({'knee': knee, 'span': span}, 'intercept', 'slope'),
                )
            )
            along_ray(['intercept'])
    one('fixed_pattern', 'rms', (0.0008, 0.0015, 0.003), 0.0, 0.02, few=False)
    one('flying_pixels', 'share', (0.12, 0.3, 0.6), 0.0, 1.0)
    one('multipath', 'gain', (0.5, 1.0, 2.0), 0.0, 5.0)
    for width in (0.1, 0.25):
        one('stray_light', 'share', (0.02,), 0.0, 0.15, f'width {width:g}', width=width)
    one('range_wrap', 'strength', (0.5, 1.0, 2.0), 0.0, 3.0)
    for half in (0.004, 0.012, 0.036, 0.11):
        one('low_signal_dropout', 'strength', (0.4, 1.6), 0.0, 4.0, f'half {half:g}', half=half)
    for half in (64.0, 70.0, 76.0, 82.0):
        one('grazing_dropout', 'strength', (0.4, 1.6), 0.0, 4.0, f'half {half:g}', half_deg=half)
    for half in (1.0, 2.0, 3.5, 6.0):
        one('saturation', 'strength', (0.4, 1.6), 0.0, 4.0, f'half {half:g}', half=half)
    one('temporal_filter', 'share', (0.2, 0.4, 0.6, 0.8), 0.0, 0.95, few=False)
    one('spatial_filter', 'mix', (0.25, 0.5, 0.8, 1.0), 0.0, 1.0)
    one('excess_noise', 'factor', (0.8, 1.15, 1.3, 1.6), 0.4, 3.0)
    if 'excess_noise' in without:
        nodes('excess_noise', 'factor', (0.8, 1.15))  # for a base sigma that is a little wrong
    one('ambient_light', 'k', (0.0001, 0.0002, 0.0004, 0.0008, 0.0016), 0.0, 0.01)
    one('heavy_tails', 'share', (0.005, 0.01, 0.02, 0.04), 0.0, 0.2)
    one('lateral_noise', 'strength', (0.5, 1.0, 2.0), 0.0, 4.0, few=False)
    one('quantisation', 'step', (0.001, 0.002, 0.004, 0.008), 0.0, 0.02)
    for stamp in (1.0, 0.0):  # What the driver stamps: the last raw frame, or the first.
        one(
            'motion_artefact',
            'stretch',
            (1.0, 2.0),
            0.0,
            3.0,
            f'stamp at {stamp:g}',
            stamp_at=stamp,
        )
    one('time_offset', 'latency', (-0.02, 0.01, 0.02, 0.04), -0.08, 0.12)
    if 'intrinsics_error' not in without:
        steps = {'focal': 0.005, 'cx': 0.7, 'cy': 0.7, 'k1': -0.01}
        terms = tuple(
            Term(
                name,
                nodes(
                    'intrinsics_error',
                    name,
                    (value,),
                    True,
                    **{other: 0.0 for other in steps if other != name},
                ),
                -10 * abs(value),
                10 * abs(value),
            )
            for name, value in steps.items()
        )
        for label, some in (
            ('focal length', ['focal']),
            ('centre', ['cx', 'cy']),
            ('distortion', ['k1']),
            ('all', list(steps)),
        ):
            candidates.append(
                Candidate(
                    'intrinsics_error',
                    label,
                    tuple(t for t in terms if t.name in some),
                    _named(dict.fromkeys(steps, 0.0), *some),
                )
            )
    if 'pose_error' not in without:
        candidates.append(Candidate('pose_error', '', (), _named({})))
    chosen = list(columns.values())
    if not modulation:
        chosen = [
            c for c in chosen if not any(loadable()[name].needs_modulation for name in c.effects)
        ]
        candidates = [
            c for c in candidates if not loadable()[c.effect].needs_modulation and c.given is None
        ]
    return chosen, candidates


def _named(fixed: dict[str, float], *names: str) -> Callable[[tuple[float, ...]], dict[str, Any]]:
    return lambda values: {**fixed, **dict(zip(names, (float(v) for v in values), strict=True))}
