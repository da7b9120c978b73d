"""Fit the forms of named effects, and take those that left-out recordings pay for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.effects.tables import Curve, PixelMap
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.forms import dropout
from flexx2_sim_ros.gap.forms.bias import BIASES, Form, forms_of
from flexx2_sim_ros.gap.forms.fitting import BiasFit, Fitted, is_surely_less
from flexx2_sim_ros.gap.forms.pattern import map_of, PixelErrors
from flexx2_sim_ros.gap.forms.samples import Samples
from flexx2_sim_ros.gap.forms.work import Looked, Settings
import numpy as np

PATTERN = 'fixed_pattern'


@dataclass(frozen=True)
class Proposal:
    """
    A form for one effect.

    Attributes
    ----------
    effect, label : str
        Its name, and which form.
    together : mapping
        Settings fitted to all recordings.
    without : tuple of mapping
        The same without each recording in turn.

    """

    effect: str
    label: str
    together: dict[str, Any]
    without: tuple[dict[str, Any], ...]


@dataclass(frozen=True)
class Verdict:
    """
    Whether a proposal is taken.

    Attributes
    ----------
    proposal : Proposal
    before, after : numpy.ndarray
        (R,) how far each recording is from its simulation, with the effect as diagnosed and with
        the form fitted without this recording.
    taken : bool

    """

    proposal: Proposal
    before: np.ndarray
    after: np.ndarray
    taken: bool


Judge = Callable[[list[tuple[Looked, Settings]]], np.ndarray]
Pixels = Callable[[list[tuple[Looked, Settings]]], list[PixelErrors]]


def calibratable(effects: Settings) -> list[str]:
    """Return which effects have a form, in the order in which they are fitted."""
    return [name for name in (*BIASES, PATTERN, *dropout.KINDS) if name in effects]


def calibrate_effects(
    looked: Sequence[Looked], effects: Settings, judge: Judge, pixels: Pixels
) -> list[Verdict]:
    """
    Fit a form for each effect that can have one.

    Parameters
    ----------
    looked : sequence of Looked
        The recordings, three or more.
    effects : dict
        Settings by effect, as diagnosed, without an error of the poses.
    judge, pixels : callable
        `work.judge` and `work.look_at_pixels` of several jobs.

    Returns
    -------
    list of Verdict
        One for each effect that can have a form, in the order of fitting.

    """
    verdicts: list[Verdict] = []
    now = [effects for _ in looked]
    before = judge(list(zip(looked, now, strict=True)))
    proposals = _biases(looked, effects)
    for name in calibratable(effects):
        if name == PATTERN:
            proposal = _pattern(looked, now, pixels)
        elif name in dropout.KINDS:
            proposal = _dropout(name, looked)
        elif name in proposals:
            proposal = proposals[name]
        else:
            continue
        changed = [
            {**own, name: {**own[name], **form}}
            for own, form in zip(now, proposal.without, strict=True)
        ]
        after = judge(list(zip(looked, changed, strict=True)))
        gain = float((before - after).mean())
        taken = gain > FORMS.least and is_surely_less(after, before)
        verdicts.append(Verdict(proposal, before, after, taken))
        if taken:
            now, before = changed, after
    return verdicts


def _biases(looked: Sequence[Looked], effects: Settings) -> dict[str, Proposal]:
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
    return {name: _proposal(final, chosen[name]) for name in names}


def _less_others(one: Looked, fitted: Sequence[str]) -> Samples:
    # Samples without what other effects change, as far as they were diagnosed.
    others = [shift for name, shift in one.shifts.items() if name not in fitted]
    return replace(one.samples, error=one.samples.error - np.sum(others, axis=0))


def _proposal(fitted: Fitted, form: Form) -> Proposal:
    part = fitted.part(form)
    return Proposal(
        form.effect,
        form.label,
        _strong(curve=form.curve(fitted.together[part])),
        tuple(_strong(curve=form.curve(theta[part])) for theta in fitted.without),
    )


def _pattern(looked: Sequence[Looked], now: Sequence[Settings], pixels: Pixels) -> Proposal:
    rest = [{k: v for k, v in own.items() if k != PATTERN} for own in now]
    errors = pixels(list(zip(looked, rest, strict=True)))

    def settings(some: Sequence[PixelErrors]) -> dict[str, Any]:
        return _strong(pattern=PixelMap(np.clip(np.round(map_of(some), 6), -0.2, 0.2)))

    return Proposal(
        PATTERN,
        'map of the image',
        settings(errors),
        tuple(settings(part) for part in _all_but_one(errors)),
    )


def _dropout(name: str, looked: Sequence[Looked]) -> Proposal:
    counts = [one.counts for one in looked]
    kind = dropout.best_kind(name, counts)

    def settings(some: Sequence[dropout.Counts]) -> dict[str, Any]:
        return _strong(**{kind.field: dropout.table_of(kind, some)})

    return Proposal(
        name,
        f'monotone table over {kind.over}',
        settings(counts),
        tuple(settings(part) for part in _all_but_one(counts)),
    )


def _all_but_one(items: Sequence[Any]) -> list[list[Any]]:
    return [[*items[:i], *items[i + 1 :]] for i in range(len(items))]


def _strong(**form: Curve | PixelMap) -> dict[str, Any]:
    # A form is fitted at strength 1.
    return {'strength': 1.0, **form}
