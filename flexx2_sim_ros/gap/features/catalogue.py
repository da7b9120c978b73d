"""
The effects that a gap is explained with: what is simulated of each, and how it is combined.

All of it follows from the effects' own hypotheses (`flexx2_sim_ros.effects.hypothesis`).
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from flexx2_sim_ros.effects import Effect, of_role, registry
from flexx2_sim_ros.effects import hypothesis as declared
from flexx2_sim_ros.effects.ray import AlongRay
from flexx2_sim_ros.effects.registry import loadable
from flexx2_sim_ros.gap.features.search import Found

Table = dict[str, dict[str, float]]


class Decaying(NamedTuple):
    """
    A column that decays with the time since power-on.

    `factor` is on what `column` simulates, at power-on; `tau` is the time constant, seconds.
    """

    column: str
    factor: float
    tau: float


@dataclass(frozen=True)
class CandidateTerm:
    """
    One parameter of a candidate, `name` for people.

    The shift of all features was simulated at the values of `nodes`, each with the column's name.
    Between them and zero it is interpolated, beyond them extrapolated. `low` and `high` bound the
    value; at `neutral` nothing is changed.
    """

    name: str
    nodes: tuple[tuple[float, str | Decaying], ...]
    low: float
    high: float
    neutral: float = 0.0


@dataclass(frozen=True)
class Candidate:
    """
    An effect in one of its variants.

    * `label`: which variant.
    * `build`: from the terms' values to the effect's parameters.
    * `given`: what stands for it in the outcome: phase is measured along the ray, the catalogue's
      effects act along the optical axis. An effect is recognised in either form, and given in the
      catalogue's, fitted as that.
    * `kind`: the effect's definition; `Effect` itself for a set of effects.
    * `steps`: whether its values are steps from those that the base simulator has.
    """

    effect: str
    label: str
    terms: tuple[CandidateTerm, ...]
    build: Callable[[tuple[float, ...]], dict[str, float]]
    given: 'Candidate | None' = None
    kind: type[Effect] = Effect
    steps: bool = False

    @property
    def columns(self) -> list[str]:
        """Return the names of the simulations that it needs."""
        nodes = [node for term in self.terms for _, node in term.nodes]
        return [one if isinstance(one, str) else one.column for one in nodes]


@dataclass(frozen=True)
class Column:
    """
    A simulation to make: parameters by effect, and whether a few frames are enough.

    `without` are effects of the base simulator that it lacks.
    """

    name: str
    effects: Table
    few: bool = True
    without: tuple[str, ...] = ()

    @property
    def changed(self) -> list[str]:
        """Return the names of the effects in which it differs from the base simulator."""
        return list(dict.fromkeys([*self.effects, *self.without]))


@dataclass(frozen=True)
class Nuisances:
    """
    Columns of the errors that any campaign has, and the values at which they are simulated.

    `columns` are an offset, of depth and along the ray, and `more` and `less`: a base sigma that
    is too small, and one that is too large, by the fractions `more_by` and `less_by`.
    """

    columns: tuple[str, ...]
    more: str
    less: str
    more_by: float
    less_by: float


def catalogue(
    without: Collection[str] = (), modulation: bool = True, found: Found = MappingProxyType({})
) -> tuple[list[Column], list[Candidate]]:
    """
    Return what to simulate and what to explain a gap with.

    Effects in `without` are left out, and those that need modulation frequencies if these are not
    known. `found` is what is known of the camera's inside, as from `search.search`.
    """
    columns = {column.name: column for column in _nuisance_columns()}
    candidates: list[Candidate] = []
    for kind in registry().values():
        if kind.name in without:
            continue
        for one in (*kind.hypotheses, *_found_variants(kind, found)):
            candidate = Candidate(
                kind.name,
                one.label,
                tuple(_term(kind, term, columns) for term in one.terms),
                _named(one.fixed, [term.name for term in one.terms]),
                kind=kind,
            )
            candidates.append(candidate)
            if any(term.along_ray for term in one.terms):
                candidates.append(_along_ray(candidate, one, columns))
    if modulation:
        return list(columns.values()), candidates
    return (
        [c for c in columns.values() if not _needs_modulation(c.effects)],
        [c for c in candidates if not _needs_modulation([c.effect]) and c.given is None],
    )


def _found_variants(kind: type[Effect], found: Found) -> tuple[declared.Hypothesis, ...]:
    searched = kind.searched
    if searched is None or searched.internal not in found:
        return ()
    return searched.variants(found[searched.internal])


def _needs_modulation(names: Iterable[str]) -> bool:
    return any(loadable()[name].needs_modulation for name in names)


def nuisances() -> Nuisances:
    """Return the columns that every model needs."""
    names = tuple(one.name for one in _nuisance_columns())
    (factor,) = of_role('sigma').hypotheses[0].terms
    return Nuisances(
        names,
        names[2],
        names[3],
        min(v for v in factor.values if v > factor.neutral) - factor.neutral,
        max(v for v in factor.values if v < factor.neutral) - factor.neutral,
    )


def _nuisance_columns() -> list[Column]:
    offset, sigma = of_role('bias'), of_role('sigma')
    (bias,), (factor,) = offset.hypotheses[0].terms, sigma.hypotheses[0].terms
    return [
        _column(offset.name, bias.name, bias.values[0]),
        _column(AlongRay.name, bias.along_ray, bias.values[0]),
        _column(sigma.name, factor.name, min(v for v in factor.values if v > factor.neutral)),
        _column(sigma.name, factor.name, max(v for v in factor.values if v < factor.neutral)),
    ]


def _column(
    effect: str,
    name: str,
    value: float,
    fixed: Mapping[str, float] | None = None,
    few: bool = True,
) -> Column:
    parameters = {**(fixed or {}), name: value}
    tag = ','.join(f'{k}={v:g}' for k, v in parameters.items())
    return Column(f'{effect}:{tag}', {effect: parameters}, few)


def _term(kind: type[Effect], term: declared.Term, columns: dict[str, Column]) -> CandidateTerm:
    stand_in = term.stand_in
    if stand_in is not None:
        column = _column(stand_in.effect, stand_in.name, stand_in.value)
        columns.setdefault(column.name, column)
        return _bounded(term, _standing_in(term, stand_in, column.name))
    nodes = []
    for value in term.values:
        column = _column(kind.name, term.name, value, term.fixed, term.few)
        columns[column.name] = column
        nodes.append((value, column.name))
    return _bounded(term, tuple(nodes))


def _along_ray(
    axial: Candidate, one: declared.Hypothesis, columns: dict[str, Column]
) -> Candidate:
    # The same effects along the ray. Effects without such a form stay as they are.
    terms = []
    for term, given in zip(one.terms, axial.terms, strict=True):
        if not term.along_ray:
            terms.append(given)
            continue
        stand_in = term.stand_in
        values = term.values if stand_in is None else (stand_in.value,)
        rays = [_column(AlongRay.name, term.along_ray, value) for value in values]
        columns.update((column.name, column) for column in rays)
        nodes = (
            tuple(zip(values, (column.name for column in rays), strict=True))
            if stand_in is None
            else _standing_in(term, stand_in, rays[0].name)
        )
        terms.append(_bounded(term, nodes))
    label = f'{axial.label} along the ray'.strip()
    return Candidate(axial.effect, label, tuple(terms), axial.build, axial, axial.kind)


def _standing_in(
    term: declared.Term, stand_in: declared.StandIn, column: str
) -> tuple[tuple[float, str | Decaying], ...]:
    if stand_in.decay is None:
        return ((stand_in.value, column),)
    return tuple(
        (value, Decaying(column, value / stand_in.value, stand_in.decay)) for value in term.values
    )


def _bounded(
    term: declared.Term, nodes: tuple[tuple[float, str | Decaying], ...]
) -> CandidateTerm:
    return CandidateTerm(term.name, nodes, term.low, term.high, term.neutral)


def _named(
    fixed: Mapping[str, float], names: Collection[str]
) -> Callable[[tuple[float, ...]], dict[str, float]]:
    return lambda values: {**fixed, **dict(zip(names, (float(v) for v in values), strict=True))}
