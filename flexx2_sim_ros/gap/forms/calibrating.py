"""Fit the forms of named effects, and take those that left-out recordings pay for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.effects import of_role, registry
from flexx2_sim_ros.effects.tables import Curve, PixelMap
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.forms import dropout, noise
from flexx2_sim_ros.gap.forms.bias import BIASES, covariate_of, Form, forms_of
from flexx2_sim_ros.gap.forms.calibratable import PATTERN, shapes_of
from flexx2_sim_ros.gap.forms.fitting import BiasFit, FittedForms
from flexx2_sim_ros.gap.forms.geometry import (
    is_fitted_with_poses,
    is_settled,
    next_values,
    shape_of,
)
from flexx2_sim_ros.gap.forms.pattern import map_of, PixelErrors
from flexx2_sim_ros.gap.forms.proposals import FormProposal, FormVerdict, judged, variation
from flexx2_sim_ros.gap.forms.samples import Samples
from flexx2_sim_ros.gap.forms.scale import fit_scale, pose_width, scale_of, ScaleColumns
from flexx2_sim_ros.gap.forms.search import Numbers, search
from flexx2_sim_ros.gap.forms.work import Looked, Settings
import numpy as np


@dataclass(frozen=True)
class FormedSet:
    """
    An explanation with the forms that were tried for its effects.

    Attributes
    ----------
    looked : list of Looked
        The recordings, looked at with these effects.
    effects : dict
        Settings by effect, with the forms that are taken.
    verdicts : list of FormVerdict
        One for each effect that can have a form, in the order of fitting.
    now : list of dict
        (R,) the settings, with each form fitted without the recording.
    apart : numpy.ndarray
        (R,) how far each recording is from its simulation with ``now``.

    """

    looked: list[Looked]
    effects: Settings
    verdicts: list[FormVerdict]
    now: list[Settings]
    apart: list[dict[str, float]]

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


Jobs = Sequence[tuple[Looked, Sequence[Settings]]]


@dataclass(frozen=True)
class Work:
    """
    The work on recordings, each recording in a process of its own.

    Attributes
    ----------
    judge : callable
        `work.judge` of several jobs, with the number of frames, and whether poses settle once.
    pixels : callable
        `work.look_at_pixels` of several jobs.
    columns : callable
        `work.look_at_scale` of several jobs.
    again : callable
        `work.look_again` of several recordings, each with settings of its own.

    """

    judge: Callable[[Jobs, int | None, bool], list[list[dict[str, float]]]]
    pixels: Callable[[list[tuple[Looked, Settings]]], list[PixelErrors]]
    columns: Callable[[list[tuple[Looked, str]]], list[ScaleColumns]]
    again: Callable[[Sequence[Looked], Sequence[Settings]], list[Looked]]

    def apart(self, looked: Sequence[Looked], now: Sequence[Settings]) -> list[dict[str, float]]:
        """Return `physical.distances` of each recording with settings of its own."""
        jobs = [(one, [own]) for one, own in zip(looked, now, strict=True)]
        return [several[0] for several in self.judge(jobs, None, False)]


def calibrate_effects(
    looked: list[Looked],
    effects: Settings,
    work: Work,
    without: Sequence[Settings],
    names: Sequence[str],
    quick: bool,
) -> FormedSet:
    """
    Fit a form for each effect that can have one.

    Parameters
    ----------
    looked : sequence of Looked
        The recordings, three or more, looked at with the effects as diagnosed.
    effects : dict
        Settings by effect, as diagnosed, without an error of the poses.
    work : Work
        How the recordings are simulated.
    without : sequence of dict
        ``effects`` as diagnosed without each recording.
    names : sequence of str
        The effects to fit, in this order.
    quick : bool
        Whether searches by simulation are quick.

    Returns
    -------
    FormedSet

    """
    verdicts: list[FormVerdict] = []
    together = dict(effects)
    now = list(without)
    before = [one.apart for one in looked]
    proposals: dict[str, FormProposal] | None = None
    for name in names:
        if is_fitted_with_poses(name):
            proposal = _geometry(name, looked, now, work)
        elif registry()[name].shapes:
            proposal = _searched(name, looked, now, work, quick)
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
        elif name == noise.NAME:
            proposal = _noise(looked)
        elif name in dropout.KINDS:
            proposal = _dropout(name, looked)
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
    return FormedSet(looked, together, verdicts, now, before)


def _with_form(settings: Settings, name: str, form: Mapping[str, Any]) -> Settings:
    # Another form that an effect has already, such as `mhz` or `slant`, may win over the new one.
    others = registry()[name].tables()
    kept = {key: value for key, value in settings[name].items() if key not in others}
    return {**settings, name: {**kept, **form}}


def _geometry(
    name: str, looked: Sequence[Looked], now: Sequence[Settings], work: Work
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
    name: str, looked: Sequence[Looked], now: Sequence[Settings], work: Work, quick: bool
) -> FormProposal:
    def evaluate(sets: Sequence[Numbers]) -> np.ndarray:
        jobs = [
            (one, [_with_form(own, name, numbers) for numbers in sets])
            for one, own in zip(looked, now, strict=True)
        ]
        several = work.judge(jobs, FORMS.frames, quick)
        return np.array([[one['mismatch'] for one in part] for part in several]).T

    found = search(shapes_of(name, quick), now[0][name], evaluate, quick)
    return FormProposal(name, found.shape.label, found.together, found.without)


def _scaled(
    name: str, looked: Sequence[Looked], work: Work
) -> tuple[FormProposal, list[Looked]] | None:
    # And the recordings with priors of their poses beside which the effect shows. None where no
    # recording shows it.
    columns = work.columns([(one, name) for one in looked])
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
    curve = form.curve(fitted.together[part])
    covariate = covariate_of(form.effect)
    return FormProposal(
        form.effect,
        form.label,
        _strong(curve=curve),
        tuple(_strong(curve=form.curve(theta[part])) for theta in fitted.without),
        1.0
        if form.effect == of_role('bias').name
        else variation(np.concatenate([curve.at(getattr(one, covariate)) for one in samples])),
    )


def _pattern(looked: Sequence[Looked], now: Sequence[Settings], work: Work) -> FormProposal:
    rest = [{k: v for k, v in own.items() if k != PATTERN} for own in now]
    errors = work.pixels(list(zip(looked, rest, strict=True)))

    def settings(some: Sequence[PixelErrors]) -> dict[str, Any]:
        return _strong(pattern=PixelMap(np.clip(np.round(map_of(some), 6), -0.2, 0.2)))

    return FormProposal(
        PATTERN,
        'map of the image',
        settings(errors),
        tuple(settings(part) for part in _all_but_one(errors)),
    )


def _noise(looked: Sequence[Looked]) -> FormProposal:
    noises = [one.noise for one in looked]
    field = noise.best_field(noises)
    together, *without = (
        _strong(**{field: noise.curve_of(field, some)}) for some in (noises, *_all_but_one(noises))
    )
    return FormProposal(noise.NAME, f'factor over {noise.WORDS[field]}', together, tuple(without))


def _dropout(name: str, looked: Sequence[Looked]) -> FormProposal:
    counts = [one.counts for one in looked]
    kind = dropout.best_kind(name, counts)

    def settings(some: Sequence[dropout.Counts]) -> dict[str, Any]:
        return _strong(**{kind.field: dropout.table_of(kind, some)})

    return FormProposal(
        name,
        f'monotone table over {kind.over}',
        settings(counts),
        tuple(settings(part) for part in _all_but_one(counts)),
        variation(
            dropout.table_of(kind, counts).at(dropout.middles(kind.over)),
            dropout.together(counts).seen[kind.over],
        ),
    )


def _all_but_one(items: Sequence[Any]) -> list[list[Any]]:
    return [[*items[:i], *items[i + 1 :]] for i in range(len(items))]


def _strong(**form: Curve | PixelMap) -> dict[str, Any]:
    # A form is fitted at strength 1.
    return {'strength': 1.0, **form}
