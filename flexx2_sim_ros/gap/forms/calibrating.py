"""Fit the forms of named effects, and take those that left-out recordings pay for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.effects import Effect, of_role, parse_effects, registry
from flexx2_sim_ros.effects.tables import PixelMap
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.campaign import Found
from flexx2_sim_ros.gap.features.work import Simulator
from flexx2_sim_ros.gap.forms.bias import BIASES, covariate_of, Form, forms_of
from flexx2_sim_ros.gap.forms.bias_fit import BiasFit, FittedForms
from flexx2_sim_ros.gap.forms.binned import best_kind, dead_of, KINDS, map_of, NOISE, pooled
from flexx2_sim_ros.gap.forms.geometry import (
    is_fitted_with_poses,
    is_settled,
    next_values,
    shape_of,
)
from flexx2_sim_ros.gap.forms.looked import (
    judge,
    look,
    look_again,
    look_at_lost,
    look_at_pixels,
    look_at_scale,
    Looked,
    Settings,
)
from flexx2_sim_ros.gap.forms.proposals import (
    calibratable,
    DEAD,
    FormProposal,
    FormVerdict,
    judged,
    PATTERN,
    shapes_of,
    variation,
)
from flexx2_sim_ros.gap.forms.samples import Samples
from flexx2_sim_ros.gap.forms.scale import fit_scale, pose_width, scale_of
from flexx2_sim_ros.gap.forms.shape_search import Numbers, search
from flexx2_sim_ros.gap.inference.effects import of_camera
import numpy as np

Step = Callable[[], None]


@dataclass(frozen=True)
class FormedSet:
    """
    An explanation with the forms that were tried for its effects.

    `looked` are the recordings, looked at with these effects. `effects` has settings by effect,
    with the forms that are taken; `now`, (R,), the same with each form fitted without the
    recording. `verdicts` has one for each effect that can have a form, in the order of fitting.
    """

    looked: list[Looked]
    effects: Settings
    verdicts: list[FormVerdict]
    now: list[Settings]

    @property
    def fits_lens(self) -> bool:
        """
        Return whether a fitted lens is taken.

        A pose error that was diagnosed besides made up for a part of the diagnosed lens. It does
        not suit the fitted one.
        """
        return any(
            one.taken and is_fitted_with_poses(one.proposal.effect) for one in self.verdicts
        )

    @property
    def beside_poses(self) -> bool:
        """Return whether a scale is taken that was fitted beside what poses hide."""
        return any(one.taken and registry()[one.proposal.effect].scale for one in self.verdicts)


@dataclass(frozen=True)
class Calibrated:
    """
    Named effects with their forms, and what is left of the gap with them.

    `typical` has settings by effect in the form of the catalogue.
    """

    explained: FormedSet
    typical: Settings

    @property
    def taken(self) -> bool:
        """Return whether a form was taken."""
        return any(one.taken for one in self.explained.verdicts)

    @property
    def dropped(self) -> list[str]:
        """Return the names of effects that do not suit these forms: a pose error beside a lens."""
        return [of_role('pose').name] if self.explained.fits_lens else []

    def effects(self, named: Sequence[Effect]) -> list[Effect]:
        """Return the other named effects with the forms that are taken, in the same order."""
        forms = {one.name: one for one in parse_effects(self.explained.effects)}
        return [forms.get(one.name, one) for one in named if one.name not in self.dropped]


def calibrate_named(
    used: Sequence[Found],
    motions: Sequence[np.ndarray],
    named: Sequence[Effect],
    held_out: Sequence[Sequence[Effect]],
    simulator: Simulator,
    step: Step,
    quick: bool = True,
) -> Calibrated | None:
    """
    Fit the forms of named effects.

    None where no effect has such a form, or where too few recordings can be left out. `motions`
    are (6 + 3 P,) where each recording's camera and planes are as far as is known, as for
    `registration.place`. The effects are as fitted to all recordings, and without each recording
    (`held_out`). `step` is called after each recording. With `quick` only forms that need no
    search by simulation, or a quick one, are fitted.
    """
    effects = of_camera(named)
    names = calibratable(effects, quick)
    if len(used) < FORMS.fewest or not names:
        return None
    without = [of_camera(own) for own in held_out]
    items = list(zip(used, without, motions, strict=True))
    found = simulator.run(look, items, step, prior=simulator.prior)
    looked = [one for one in found if isinstance(one, Looked)]
    if len(looked) < len(used):  # A file was removed meanwhile.
        return None
    if len({one.shape for one in looked}) > 1:  # A map has one number for each pixel.
        names = [name for name in names if name not in (PATTERN, DEAD)]
    work = _Work(simulator, step, quick)
    return Calibrated(_formed(looked, effects, without, names, work), effects)


@dataclass(frozen=True)
class _Work:
    # Who simulates, what to call after each recording that is judged, and if searches are quick.
    simulator: Simulator
    step: Step
    quick: bool

    def again(self, looked: Sequence[Looked], now: Sequence[Settings]) -> list[Looked]:
        return self.simulator.run(look_again, list(zip(looked, now, strict=True)))

    def apart(self, looked: Sequence[Looked], now: Sequence[Settings]) -> list[dict[str, float]]:
        # `physical.distances` of each recording with settings of its own.
        jobs = [(one, [own]) for one, own in zip(looked, now, strict=True)]
        return [several[0] for several in self.simulator.run(judge, jobs, self.step)]


def _formed(
    looked: list[Looked],
    effects: Settings,
    without: Sequence[Settings],
    names: Sequence[str],
    work: _Work,
) -> FormedSet:
    # A form for each of these effects, in this order.
    verdicts: list[FormVerdict] = []
    together = dict(effects)
    now = list(without)
    before = [one.apart for one in looked]
    proposals: dict[str, FormProposal] | None = None
    for name in names:
        if is_fitted_with_poses(name):
            proposal = _geometry(name, looked, now, work)
        elif registry()[name].shapes:
            proposal = _searched(name, looked, now, work)
        elif registry()[name].scale:
            if verdicts:
                looked = work.again(looked, now)
            scaled = _scaled(name, looked, work)
            if scaled is None:
                continue
            wide, (proposal, looked) = (looked, before), scaled
            before = work.apart(looked, now)
        elif name == PATTERN:
            proposal = _pattern(looked, now, work)
        elif name == DEAD:
            dead = _dead(looked, now, work)
            if dead is None:
                continue
            proposal = dead
        elif name in KINDS:
            proposal = _binned(name, looked)
        else:
            if proposals is None:
                if verdicts:  # What mixes light has other settings now.
                    looked = work.again(looked, now)
                proposals = _biases(looked, names)
            if name not in proposals:
                continue
            proposal = proposals[name]
        changed = [
            _with_form(own, name, form) for own, form in zip(now, proposal.without, strict=True)
        ]
        after = work.apart(looked, changed)
        verdict = judged(proposal, before, after)
        verdicts.append(verdict)
        if verdict.taken:
            now, before = changed, after
            together = _with_form(together, name, proposal.together)
        elif registry()[name].scale:
            looked, before = wide
    return FormedSet(looked, together, verdicts, now)


def _with_form(settings: Settings, name: str, form: Mapping[str, Any]) -> Settings:
    # Another form that an effect has already, such as `mhz` or `slant`, may win over the new one.
    others = registry()[name].tables()
    kept = {key: value for key, value in settings[name].items() if key not in others}
    return {**settings, name: {**kept, **form}}


def _geometry(
    name: str, looked: Sequence[Looked], now: Sequence[Settings], work: _Work
) -> FormProposal:
    # During a diagnosis, recordings start from settings of their own; after the first round, all
    # have the same ones.
    there = looked
    settings = dict(now[0])
    for round_ in range(FORMS.rounds):
        if round_:
            there = work.again(there, [settings] * len(there))
        together, without = next_values(
            name, [_less_others(one, ()) for one in there], settings[name]
        )
        last, settings[name] = settings[name], {**settings[name], **together}
        if is_settled(name, last, settings[name]):
            break
    return FormProposal(name, shape_of(name).label, together, without, with_poses=True)


def _searched(
    name: str, looked: Sequence[Looked], now: Sequence[Settings], work: _Work
) -> FormProposal:
    quick = work.quick

    def evaluate(sets: Sequence[Numbers]) -> np.ndarray:
        jobs = [
            (one, [_with_form(own, name, numbers) for numbers in sets])
            for one, own in zip(looked, now, strict=True)
        ]
        several = work.simulator.run(
            judge, jobs, work.step, frames=FORMS.frames, settle_once=quick
        )
        return np.array([[one['mismatch'] for one in part] for part in several]).T

    found = search(shapes_of(name, quick), now[0][name], evaluate, quick)
    return FormProposal(name, found.shape.label, found.together, found.without)


def _scaled(
    name: str, looked: Sequence[Looked], work: _Work
) -> tuple[FormProposal, list[Looked]] | None:
    # And the recordings with priors of their poses beside which the effect shows. None where no
    # recording shows it.
    columns = work.simulator.run(look_at_scale, [(one, name) for one in looked])
    if all(one.none for one in columns):
        return None
    width = pose_width([_less_others(one, (name,)) for one in looked], columns)
    looked = [
        replace(one, samples=replace(one.samples, spread=width * one.samples.spread))
        for one in looked
    ]
    together, *without = fit_scale(name, [_less_others(one, (name,)) for one in looked], columns)
    scale = scale_of(name)
    if not together[scale.name]:
        return None
    return FormProposal(name, scale.label, together, tuple(without), with_poses=True), looked


def _biases(looked: Sequence[Looked], effects: Sequence[str]) -> dict[str, FormProposal]:
    names = [name for name in BIASES if name in effects]
    if any(one.uptime is None for one in looked):
        names = [name for name in names if name != 'warm_up_drift']
    if not names:
        return {}
    mode = looked[0].found.mode
    fit = BiasFit([_less_others(one, names) for one in looked])
    chosen: dict[str, Form] = {}
    for _ in range(1 if len(names) == 1 else 2):  # Again with the forms of the others.
        for name in names:
            others = [form for other, form in chosen.items() if other != name]
            chosen[name] = fit.best(forms_of(name, mode), others).forms[0]
    final = fit.fit(list(chosen.values()))
    samples = [one.samples for one in looked]
    return {name: _proposal(final, chosen[name], samples) for name in names}


def _less_others(one: Looked, fitted: Sequence[str]) -> Samples:
    # Samples without what other effects change, as far as they were diagnosed.
    others = [shift for name, shift in one.shifts.items() if name not in fitted]
    return replace(one.samples, error=one.samples.error - np.sum(others, axis=0))


def _proposal(fitted: FittedForms, form: Form, samples: Sequence[Samples]) -> FormProposal:
    part = fitted.part(form)
    curves = [form.curve(theta[part]) for theta in (fitted.together, *fitted.without)]
    varies = 1.0
    if form.effect != of_role('bias').name:
        covariate = covariate_of(form.effect)
        varies = variation(
            np.concatenate([curves[0].at(getattr(one, covariate)) for one in samples])
        )
    together, *without = (_strong(curve=curve) for curve in curves)
    return FormProposal(form.effect, form.label, together, tuple(without), varies)


def _pattern(looked: Sequence[Looked], now: Sequence[Settings], work: _Work) -> FormProposal:
    rest = [{k: v for k, v in own.items() if k != PATTERN} for own in now]
    errors = work.simulator.run(look_at_pixels, list(zip(looked, rest, strict=True)))
    together, *without = (
        _strong(pattern=PixelMap(np.clip(np.round(map_of(some), 6), -0.2, 0.2)))
        for some in _less_each(errors)
    )
    return FormProposal(PATTERN, 'map of the image', together, tuple(without))


def _dead(looked: Sequence[Looked], now: Sequence[Settings], work: _Work) -> FormProposal | None:
    # None where no pixel is dead.
    shares = work.simulator.run(look_at_lost, list(zip(looked, now, strict=True)))
    lost = [min(own[DEAD]['strength'] * own[DEAD]['share'], 1.0) for own in now]
    each = zip(_less_each(shares), [float(np.mean(lost)), *lost], strict=True)
    maps = [one for some, share in each if (one := dead_of(some, share)) is not None]
    if len(maps) <= len(looked):
        return None
    together, *without = (_strong(dead=PixelMap(np.round(one, 4))) for one in maps)
    return FormProposal(DEAD, 'map of dead pixels', together, tuple(without))


def _binned(name: str, looked: Sequence[Looked]) -> FormProposal:
    shown = [one.binned[name] for one in looked]
    kind = best_kind(name, shown)
    curves = [kind.curve(pooled(some)) for some in _less_each(shown)]
    varies = 1.0
    if name != NOISE:
        varies = variation(curves[0].at(kind.middles), pooled(shown).weight[kind.over])
    together, *without = (_strong(**dict(kind.fixed), **{kind.field: curve}) for curve in curves)
    return FormProposal(name, kind.label, together, tuple(without), varies)


def _less_each(items: Sequence[Any]) -> list[list[Any]]:
    # All of them, and all but each one.
    return [[*items], *([*items[:i], *items[i + 1 :]] for i in range(len(items)))]


def _strong(**form: Any) -> dict[str, Any]:
    # A form is fitted at strength 1.
    return {'strength': 1.0, **form}
