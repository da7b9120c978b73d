"""Write the files of a calibration, whole or not at all, and its page."""

from collections.abc import Sequence
from html import escape
import json
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import output_folder, whole_files
from flexx2_sim_ros.effects import Effect, loadable, save_effects
from flexx2_sim_ros.effects.tables import Curve, PixelMap
from flexx2_sim_ros.gap.forms import dropout, noise
from flexx2_sim_ros.gap.forms.bias import covariate_of
from flexx2_sim_ros.gap.forms.proposals import Proposal, Verdict
from flexx2_sim_ros.gap.forms.work import Looked
from flexx2_sim_ros.gap.report.text import moved, percent, spaced
from flexx2_sim_ros.gap.report.words import why_dropped
from flexx2_sim_ros.html_drawing import CURVE_STYLE, curves, picture
from flexx2_sim_ros.html_page import html_page
import numpy as np

FILES = ('effects.yaml', 'calibration.json', 'calibration.html', 'diagnosis.json')
_STYLE = """
td, th { padding: .18rem .9rem .18rem 0; text-align: left; vertical-align: top; }
th, small, .dim, figcaption { color: var(--dim); } figcaption { font-size: .85rem; }
.row { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.row figure { max-width: 27.5rem; }
"""
BAND_STYLE = '.band { fill: var(--blue); opacity: .18; }'
_POINTS = 60
_NINETY = 1.645  # standard errors, two-sided
# On the values of a curve, and what they are then; a bias if it is not said.
_UNITS = {
    **dict.fromkeys(dropout.KINDS, (100.0, 'invalid, %')),
    noise.NAME: (1.0, 'factor on sigma_z'),
}


def write_calibration(
    folder: Path,
    table: dict[str, Any],
    effects: Sequence[Effect],
    verdicts: Sequence[Verdict],
    looked: Sequence[Looked],
    diagnosis: dict[str, Any],
) -> None:
    """
    Write ``effects.yaml`` with its maps, ``calibration.json`` and ``calibration.html``.

    With ``diagnosis.json``, the folder can be used like that of a diagnosis.

    Parameters
    ----------
    folder : pathlib.Path
        Created if it does not exist; files of the same names are replaced.
    table : dict
        What `flexx2_sim_ros.gap.calibrate` returns.
    effects : sequence of Effect
        Effects of the diagnosis, with the forms that are taken.
    verdicts : sequence of Verdict
        The tried forms, for the page.
    looked : sequence of Looked
        The recordings.
    diagnosis : dict
        The content of ``diagnosis.json``.

    """
    with whole_files(output_folder(folder)) as part:
        save_effects(part / FILES[0], effects, headline(table))
        text = json.dumps(table, indent=2, allow_nan=False)
        (part / FILES[1]).write_text(text + '\n', encoding='utf-8')
        (part / FILES[2]).write_text(
            page(table, verdicts, looked), encoding='utf-8', errors='backslashreplace'
        )
        text = json.dumps(diagnosis, indent=2)
        (part / FILES[3]).write_text(text + '\n', encoding='utf-8')


def headline(table: dict[str, Any]) -> str:
    """Return the result in one sentence."""
    taken = [spaced(row['name']) for row in table['effects'] if row['taken']]
    if not taken:
        text = 'No calibrated form is better on left-out recordings: all effects stay.'
    else:
        text = f'Calibrated: {", ".join(taken)}.'
    if table['empirical'] and table['empirical']['taken']:
        text += (
            f' Empirical correction over {spaced(table["empirical"]["form"])}, without a cause.'
        )
    return text


def sentences(table: dict[str, Any]) -> list[str]:
    """Return one line for each effect: which form was tried, and the result."""
    count = len(table['recordings'])
    out = _explanations(table)
    for row in table['effects']:
        verb = 'replaces the diagnosed form' if row['taken'] else 'is not taken'
        out.append(f'{spaced(row["name"])}: {row["form"]} {verb}: {_change(row, count)}.')
    out += [
        f'{spaced(name)}: stays as it was diagnosed; it has no form that these recordings show.'
        for name in table['unchanged']
    ]
    out += map(why_dropped, table['dropped'])
    row = table['empirical']
    if row:
        verb = 'is added; its cause is not known' if row['taken'] else 'is not added'
        out.append(
            f'Empirical correction over {spaced(row["form"])} {verb}: {_change(row, count)}.'
        )
    low, high = table['gap']['interval'] or [table['gap']['shrink']] * 2
    out.append(
        f'These effects {moved(table["gap"]["shrink"], "the gap", "")} in left-out recordings '
        f'(90 % interval of the reduction: {percent(low)} to {percent(high)}).'
    )
    return out + [f'Left out: {row["reason"]}.' for row in table['left_out']]


def _explanations(table: dict[str, Any]) -> list[str]:
    # Says which explanation was calibrated if there are several.
    rows = table['explanations']
    if len(rows) < 2:
        return []
    names = [', '.join(map(spaced, row['effects'])) for row in rows]
    tried = '; '.join(
        f'{name} ({row["distance"]:.3g})' for name, row in zip(names, rows, strict=True)
    )
    (chosen,) = (name for name, row in zip(names, rows, strict=True) if row['chosen'])
    return [f'Explanations that were calibrated, with their distance: {tried}. Taken: {chosen}.']


def _change(row: dict[str, Any], count: int) -> str:
    worse = f'; worse: {", ".join(map(spaced, row["worse"]))}' if row['worse'] else ''
    return (
        f'distance {row["before"]:.3g} to {row["after"]:.3g}, smaller in '
        f'{row["recordings_better"]} of {count} left-out recordings{worse}'
    )


def page(table: dict[str, Any], verdicts: Sequence[Verdict], looked: Sequence[Looked]) -> str:
    """Return the page as HTML, all text escaped and all pictures inside."""
    rows = ''.join(
        f'<tr><td>{escape(row["name"])}</td><td>{escape(row["form"])}</td>'
        f'<td>{"taken" if row["taken"] else "not taken"}</td><td>{row["before"]:.3g}</td>'
        f'<td>{row["after"]:.3g}</td><td>{row["recordings_better"]}</td></tr>'
        for row in table['effects']
    )
    drawn = figures(verdicts, looked, ('as diagnosed', 'calibrated'))
    body = [
        f'<h1>{escape(headline(table))}</h1>',
        ''.join(f'<p>{escape(line)}</p>' for line in sentences(table)),
        '<h2>Forms</h2><div class="scroll"><table><tr><th>effect</th><th>form</th><th></th>'
        '<th>distance as diagnosed</th><th>calibrated</th><th>recordings nearer</th></tr>'
        f'{rows}</table></div><p><small>Distance of a recording from its simulation: '
        'Wasserstein-1 distance of depth errors in small tiles in units of 0.1 sigma_z, plus the '
        'difference of the fraction of invalid pixels in units of 0.8 %. Each recording is '
        'compared with the form fitted to the others.</small></p>',
        f'<h2>Curves and maps</h2><div class="row">{drawn}</div>'
        '<p><small>Bands: 90 % intervals over recordings (jackknife). Dashed: as diagnosed.'
        '</small></p>',
        f'<p class="dim">Made by flexx2_sim_ros {escape(table["version"])} in '
        f'{table["seconds"]:.0f} s from {len(looked)} recordings. docs/diagnosis.md says how each '
        'number is computed.</p>',
    ]
    return html_page('Calibration of effects', _STYLE + CURVE_STYLE + BAND_STYLE, '\n'.join(body))


def figures(verdicts: Sequence[Verdict], looked: Sequence[Looked], names: tuple[str, str]) -> str:
    """
    Return curves, maps and numbers of forms as HTML; the page needs `BAND_STYLE`.

    Parameters
    ----------
    verdicts : sequence of Verdict
        The forms.
    looked : sequence of Looked
        The recordings.
    names : tuple of str
        What to call an effect without the form, and with it.

    """
    return ''.join(_figure(one.proposal, looked, names) for one in verdicts)


def _figure(proposal: Proposal, looked: Sequence[Looked], names: tuple[str, str]) -> str:
    pattern = proposal.together.get('pattern')
    if isinstance(pattern, PixelMap):
        limit = 1000 * float(np.quantile(np.abs(pattern.values), 0.98)) or 1.0
        text = f'{spaced(proposal.effect)}: blue {-limit:.2g} to red {limit:+.2g} mm'
        return (
            f'<figure><img alt="{escape(text)}" width="420" '
            f'src="{picture(1000 * pattern.values, limit)}"><figcaption>{escape(text)}'
            '</figcaption></figure>'
        )
    fields = [name for name, value in proposal.together.items() if isinstance(value, Curve)]
    if not fields:
        return _numbers(proposal, names[1])
    (field,) = fields
    over = loadable()[proposal.effect].tables()[field].over
    x, typical = _typical(proposal, field, looked)
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


def _numbers(proposal: Proposal, title: str) -> str:
    # Each fitted parameter, with its standard error over recordings.
    rows = ''.join(
        f'<tr><td>{escape(name)}</td><td>{value:.4g}</td>'
        f'<td>{_error(np.array([one[name] for one in proposal.without])):.2g}</td></tr>'
        for name, value in proposal.together.items()
        if name != 'strength'
    )
    return (
        f'<figure><table><tr><th>{escape(spaced(proposal.effect))}</th><th>{escape(title)}</th>'
        f'<th>standard error</th></tr>{rows}</table><figcaption>{escape(proposal.label)}'
        '</figcaption></figure>'
    )


def _error(each: np.ndarray) -> Any:
    # Standard error over recordings, by the jackknife; (R, ...) fitted without each of them.
    count = len(each)
    return np.sqrt((count - 1) / count * ((each - each.mean(axis=0)) ** 2).sum(axis=0))


def _typical(
    proposal: Proposal, field: str, looked: Sequence[Looked]
) -> tuple[np.ndarray, np.ndarray]:
    # Places along the covariate, and what the effect as diagnosed is there.
    if proposal.effect in dropout.KINDS:
        return _typical_dropout(proposal.effect, field, looked)
    if proposal.effect == noise.NAME:
        knots = np.array(proposal.together[field].knots)
        return knots, noise.typical(field, [one.noise for one in looked], knots)
    return _typical_bias(proposal.effect, looked)


def _typical_bias(effect: str, looked: Sequence[Looked]) -> tuple[np.ndarray, np.ndarray]:
    # Mean change of the range by the diagnosed effect, in bins of its covariate.
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


def _typical_dropout(
    effect: str, field: str, looked: Sequence[Looked]
) -> tuple[np.ndarray, np.ndarray]:
    # Fraction of invalid pixels in the simulation with the diagnosed effects.
    (over,) = (kind.over for kind in dropout.KINDS[effect] if kind.field == field)
    fractions = dropout.together([one.typical_counts for one in looked]).fractions(over)
    known = np.isfinite(fractions)
    return dropout.middles(over)[known], fractions[known]
