"""The report of a diagnosis: one HTML page that needs no other file."""

from collections.abc import Collection, Sequence
from html import escape
from typing import Any

from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.forms.named import Calibrated
from flexx2_sim_ros.gap.inference.decide import Decision
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.report.calibration_page import BAND_STYLE, figures
from flexx2_sim_ros.gap.report.charts import charts, maps
from flexx2_sim_ros.gap.report.cost_page import section
from flexx2_sim_ros.gap.report.frames import frames, FRAMES_STYLE
from flexx2_sim_ros.gap.report.places import place
from flexx2_sim_ros.gap.report.style import STYLE
from flexx2_sim_ros.gap.report.text import percent, spaced
from flexx2_sim_ros.gap.report.words import (
    accuracy,
    calibrations,
    camera_effects,
    headline,
    MEASURES,
    not_considered,
    sentences,
)
from flexx2_sim_ros.html_drawing import bar, CURVE_STYLE
from flexx2_sim_ros.html_page import html_page

_STYLE = (
    STYLE
    + FRAMES_STYLE
    + """
figcaption { font-size: .85rem; }
td.number { white-space: nowrap; }
.none { background: #2e7d4f; } .identified { background: #1f6feb; }
.partly, .not_decidable { background: #b7791f; } .unknown { background: #a8324a; }
.row { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.row figure { max-width: 27.5rem; }
"""
)


def page(
    table: dict[str, Any],
    model: Model,
    decision: Decision,
    confirmed: Sequence[Outcome],
    calibrated: Calibrated | None,
) -> str:
    """Return the page as HTML, all text escaped and all pictures inside."""
    used = sum(row['used'] for row in table['recordings'])
    body = [
        f'<p><span class="tag {escape(table["verdict"])}">'
        f'{escape(spaced(table["verdict"]))}</span> '
        f'<small>from {used} recording{"s" * (used != 1)}</small></p>',
        f'<h1>{escape(headline(table))}</h1>',
        ''.join(f'<p>{escape(line)}</p>' for line in sentences(table)),
        _effects(table),
        _forms(calibrated),
        _shrinkage(table),
        section(table['cost']) if 'cost' in table else '',
        _where(table),
        frames(table, confirmed, model.evidence[0].axes),
        maps(confirmed, bool(table['effects'])),
        charts(confirmed, bool(table['effects']), model.evidence[0].axes),
        _considered(table, decision),
        _recordings(table),
    ]
    body.append(
        f'<p class="dim">Made by flexx2_sim_ros {escape(table["version"])} in '
        f'{table["seconds"]:.0f} s with {table["peak_mb"]:.0f} MB. docs/diagnosis.md says how '
        'each number is computed.</p>'
    )
    return html_page(
        f'Sim-to-real gap: {table["verdict"]}', _STYLE + CURVE_STYLE + BAND_STYLE, '\n'.join(body)
    )


def _numbers(*texts: str) -> str:
    return ''.join(f'<td class="number">{escape(text)}</td>' for text in texts)


def _effects(table: dict[str, Any]) -> str:
    if not table['effects']:
        return ''
    rows = []
    forms = {row['name']: row['form'] for row in calibrations(table) if row['taken']}
    for row in table['effects']:
        values = forms.get(row['name']) or ', '.join(
            f'{name} {value:.4g}' for name, value in row['parameters'].items()
        )
        low, high = map(percent, row['interval'])
        numbers = percent(row['share']), f'{low} to {high}', percent(row['confidence'])
        rows.append(
            f'<tr><td><b>{escape(spaced(row["name"]))}</b></td>'
            f'{_numbers(*numbers)}<td>{escape(values)}</td></tr>'
        )
    return (
        '<h2>What causes the gap</h2><div class="scroll"><table><tr><th>effect</th>'
        '<th>fraction of the loss</th><th>90 % interval</th><th>confidence</th>'
        f'<th>parameters</th></tr>{"".join(rows)}</table></div><p><small>The fraction is how much '
        "of the loss of the diagnosis' features goes away when this effect is added to the "
        f'others{_in_typical_form(forms)}: fractions need not add up to the reduction above. The '
        'confidence is the '
        'probability that the effect is present, calibrated on simulated campaigns. effects.yaml '
        'has these effects, for <code>flexx2 simulate --effects</code> and the camera node.'
        '</small></p>'
    )


def _in_typical_form(forms: Collection[str]) -> str:
    return ', all in the form of the catalogue' if forms else ''


def _forms(calibrated: Calibrated | None) -> str:
    taken = [one for one in calibrated.explained.verdicts if one.taken] if calibrated else []
    if calibrated is None or not taken:
        return ''
    drawn = figures(taken, calibrated.explained.looked, ('form of the catalogue', 'as fitted'))
    return (
        f'<h2>Curves and maps</h2><div class="row">{drawn}</div>'
        '<p><small>What was fitted to the recordings. Bands: 90 % intervals over recordings '
        '(jackknife). Dashed: in the form of the catalogue.</small></p>'
    )


def _shrinkage(table: dict[str, Any]) -> str:
    rows = []
    for unit, (name, symbol, factor) in MEASURES.items():
        gap = table['gap'][unit]
        first, last, least = (gap[k] * factor for k in ('before', 'after', 'null'))
        rows.append(
            f'<tr><td>{escape(name)}</td>'
            f'{_numbers(*(f"{one:.3g} {symbol}" for one in (first, last, least)))}'
            f'<td>{bar(first, last, least)}</td></tr>'
        )
    after = 'with the effects' if camera_effects(table) else 'after (no effect added)'
    fitted = ''
    if camera_effects(table):
        data = 'the other recordings' if table['gap']['held_out'] else 'the same recording'
        fitted = f' The effects were fitted to {data}.'
    return (
        '<h2>How large the gap is</h2><div class="scroll"><table><tr><th></th>'
        f'<th>as simulated</th><th>{after}</th><th>two simulations</th><th></th></tr>'
        f'{"".join(rows)}</table></div><p><small>Difference between the recordings and their '
        f'simulation, mean over recordings.{fitted} Bars: gray as simulated, blue after. The '
        'mark, and the column "two simulations", is the difference between two runs of the '
        'simulator: a perfect simulation would still show it.</small></p>'
    )


def _where(table: dict[str, Any]) -> str:
    if not table['where']:
        return '<h2>Where the gap lies</h2><p>No region differs by more than the tolerance.</p>'
    rows = ''.join(
        f'<tr><td>{escape(place(cell))}</td><td class="number"><small>'
        f'{escape(_probability(cell["q_value"]))}</small></td></tr>'
        for cell in table['where'][:12]
    )
    more = len(table['where']) - 12
    others = f' diagnosis.json has {more} more.' if more > 0 else ''
    return (
        f'<h2>Where the gap lies</h2><div class="scroll"><table>{rows}</table></div>'
        '<p><small>Real minus simulated, mean over the pixels that differ. q is the expected '
        'fraction of false findings (Benjamini and Hochberg); in the first row, the probability '
        f'that noise alone exceeds the tolerance by so much.{others}</small></p>'
    )


def _probability(q: float) -> str:
    # A smaller one may be too small for a floating-point number.
    return 'q < 1e-300' if q < 1e-300 else f'q = {q:.2g}'


def _considered(table: dict[str, Any], decision: Decision) -> str:
    rows = []
    taken = {row['name'] for row in table['effects']}
    ties = {other['name'] for other in table['alternatives']}
    for one in decision.considered[:10]:
        name = one.fit.candidates[0].effect
        fraction = max(decision.base.total - one.fit.total, 0) / decision.excess
        if name in taken:
            why = 'selected'
        elif name in ties and taken:
            why = 'alternative explanation: may be present instead of a selected effect'
        elif one.gain <= 0:
            why = 'explains nothing on recordings that were left out of the fit'
        else:
            why = 'explains less' if taken else 'explains too little'
        rows.append(
            f'<tr><td>{escape(spaced(name))}</td><td>{percent(min(fraction, 1))}</td>'
            f'<td>{escape(why)}</td></tr>'
        )
    return (
        '<h2>Effects that were considered</h2><div class="scroll"><table><tr><th>effect</th>'
        '<th>fraction of the loss that it explains alone</th><th></th></tr>'
        f'{"".join(rows)}</table></div><p><small>The other effects explain even less.</small></p>'
        + ''.join(f'<p>{escape(line)}</p>' for line in not_considered(table))
    )


def _recordings(table: dict[str, Any]) -> str:
    rows = []
    for row in table['recordings']:
        if row['used']:
            x, y, z, *turn = row['pose']
            pose = (
                f'{x * 1000:+.1f}, {y * 1000:+.1f}, {z * 1000:+.1f} mm; '
                + ', '.join(f'{angle:+.2f}' for angle in turn)
                + ' deg'
            )
            kind = 'moving' if row['moving'] else 'still'
            truth = accuracy([row['truth']])
            lines = [f'ground truth: {truth}'] * bool(truth) + row['notes']
            notes = ''.join(f'<br><small>{escape(line)}</small>' for line in lines)
            rows.append(
                f'<tr><td>{escape(row["name"])}</td><td>{row["frames"]} frames, {kind}'
                f'</td><td>{pose}{notes}</td></tr>'
            )
        else:
            rows.append(
                f'<tr><td>{escape(row["name"])}</td><td>left out</td>'
                f'<td>{escape(row["reason"])}</td></tr>'
            )
    return (
        '<h2>Recordings</h2><div class="scroll"><table><tr><th>file</th><th></th><th>fitted pose '
        f'error (right, down, forward; pitch, yaw, roll)</th></tr>{"".join(rows)}</table></div>'
    )
