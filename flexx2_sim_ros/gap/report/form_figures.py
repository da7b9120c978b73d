"""Draw the forms that a diagnosis gives its effects: curves, maps and numbers."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.effects import loadable
from flexx2_sim_ros.effects.tables import Curve, PixelMap
from flexx2_sim_ros.gap.forms.bias import covariate_of
from flexx2_sim_ros.gap.forms.binned import KINDS, NOISE, pooled
from flexx2_sim_ros.gap.forms.looked import Looked
from flexx2_sim_ros.gap.forms.proposals import DEAD, FormProposal, FormVerdict
from flexx2_sim_ros.gap.report.text import spaced
from flexx2_sim_ros.html_drawing import curves, picture
import numpy as np

_POINTS = 60
_NINETY = 1.645  # standard errors, two-sided
# On the values of a curve, and what they are then; a bias if it is not said.
_UNITS = {**dict.fromkeys(KINDS, (100.0, 'invalid, %')), NOISE: (1.0, 'factor on sigma_z')}


def figures(
    verdicts: Sequence[FormVerdict], looked: Sequence[Looked], names: tuple[str, str]
) -> html.Html:
    """
    Return curves, maps and numbers of forms as HTML.

    `names` is what to call an effect without the form, and with it.
    """
    return html.join(*(_figure(one.proposal, looked, names) for one in verdicts))


def _figure(proposal: FormProposal, looked: Sequence[Looked], names: tuple[str, str]) -> html.Html:
    maps = [one for one in proposal.together.values() if isinstance(one, PixelMap)]
    if maps:
        return _map(proposal.effect, maps[0].values)
    fields = [name for name, value in proposal.together.items() if isinstance(value, Curve)]
    if not fields:
        return _numbers(proposal, names[1])
    (field,) = fields
    over = loadable()[proposal.effect].tables()[field].over
    x, typical = _typical(proposal.effect, field, looked)
    factor, unit = _UNITS.get(proposal.effect, (1000.0, 'along the ray, mm'))
    middle = proposal.together[field].at(x)
    each = np.array([one[field].at(x) for one in proposal.without], np.float64)
    error = _error(each)
    return curves(
        x,
        factor * np.array([typical, middle]),
        names,
        over,
        f'{spaced(proposal.effect)}: {unit}',
        0.5,
        kinds=('simulated', 'effects'),
        band=factor * np.array([middle - _NINETY * error, middle + _NINETY * error]),
    )


def _map(effect: str, values: np.ndarray) -> html.Html:
    if effect == DEAD:
        text = f'{spaced(effect)}: red is always lost, white never'
        return html.figure(picture(values, 1.0), text, width=420)
    limit = 1000 * float(np.quantile(np.abs(values), 0.98)) or 1.0
    text = f'{spaced(effect)}: blue {-limit:.2g} to red {limit:+.2g} mm'
    return html.figure(picture(1000 * values, limit), text, width=420)


def _numbers(proposal: FormProposal, title: str) -> html.Html:
    # Each fitted parameter, with its standard error over recordings.
    rows = [
        (name, f'{value:.4g}', f'{_error(np.array([one[name] for one in proposal.without])):.2g}')
        for name, value in proposal.together.items()
        if name != 'strength'
    ]
    return html.element(
        'figure',
        html.table([spaced(proposal.effect), title, 'standard error'], rows),
        html.element('figcaption', proposal.label),
    )


def _error(each: np.ndarray) -> Any:
    # Standard error over recordings, by the jackknife; (R, ...) fitted without each of them.
    count = len(each)
    return np.sqrt((count - 1) / count * ((each - each.mean(axis=0)) ** 2).sum(axis=0))


def _typical(effect: str, field: str, looked: Sequence[Looked]) -> tuple[np.ndarray, np.ndarray]:
    # Places along the covariate, and what the effect as diagnosed is there: of a bias the mean
    # change of the range, in bins of its covariate.
    for kind in KINDS.get(effect, ()):
        if kind.field == field:
            known = pooled([one.binned[effect] for one in looked]).weight[kind.over] > 0
            typical = pooled([one.typical[effect] for one in looked]).mean(kind.over)
            return kind.middles[known], typical[known]
    values = np.concatenate([getattr(one.samples, covariate_of(effect)) for one in looked])
    shift = np.concatenate([one.shifts[effect] * one.samples.length for one in looked])
    low, high = np.quantile(values, (0.005, 0.995))
    edges = np.linspace(low, high, _POINTS + 1)
    place = np.digitize(values, edges) - 1
    inside = (place >= 0) & (place < _POINTS)
    total = np.bincount(place[inside], shift[inside], minlength=_POINTS)
    count = np.bincount(place[inside], minlength=_POINTS)
    with np.errstate(invalid='ignore', divide='ignore'):
        return (edges[1:] + edges[:-1]) / 2, total / count
