"""The report of a diagnosis: one HTML page that needs no other file."""

from collections.abc import Sequence
from html import escape
from typing import Any

from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.forms.named import Calibrated
from flexx2_sim_ros.gap.inference.decide import Decision
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.report.attribution import (
    attribution,
    disagreeing,
    HEADS,
    poses_hide,
    shown_by_one,
)
from flexx2_sim_ros.gap.report.charts import charts, maps
from flexx2_sim_ros.gap.report.cost_page import section
from flexx2_sim_ros.gap.report.form_figures import BAND_STYLE, figures
from flexx2_sim_ros.gap.report.frames import frames, FRAMES_STYLE
from flexx2_sim_ros.gap.report.places import difference, group
from flexx2_sim_ros.gap.report.style import definitions, STYLE
from flexx2_sim_ros.gap.report.text import percent, short, spaced
from flexx2_sim_ros.gap.report.words import (
    accuracy,
    calibrations,
    camera_effects,
    headline,
    MEANINGS,
    MEASURES,
    MOST_SENTENCES,
    not_considered,
    refusals,
    REFUSED,
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
td.values { min-width: 13rem; }
.none { background: #2e7d4f; } .identified { background: #1f6feb; }
.partly, .not_decidable { background: #b7791f; } .unknown { background: #a8324a; }
.row { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.row figure { max-width: 27.5rem; }
"""
)
_VERDICTS = {
    'none': 'no gap',
    'identified': 'cause identified',
    'partly': 'partly explained',
    'unknown': 'cause unknown',
    'not_decidable': 'not decidable',
    'too_little': 'too little data',
}
_DOUBTFUL = 0.05  # rows of `where` with a larger false discovery rate are marked


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
        f'{escape(_VERDICTS[table["verdict"]])}</span> '
        f'<small>from {used} recording{"s" * (used != 1)}</small></p>',
        f'<h1>{escape(headline(table))}</h1>',
        _effects(table),
        _said([*disagreeing(table), *sentences(table)]),
        _forms(calibrated),
        _shrinkage(table),
        section(table['cost']) if 'cost' in table else '',
        _where(table),
        frames(table, confirmed, model.evidence[0].axes),
        maps(confirmed, bool(camera_effects(table))),
        charts(confirmed, bool(camera_effects(table)), model.evidence[0].axes),
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


def _said(lines: Sequence[str]) -> str:
    # The first sentences, and the others folded.
    first, rest = (
        ''.join(f'<p>{escape(line)}</p>' for line in some)
        for some in (lines[:MOST_SENTENCES], lines[MOST_SENTENCES:])
    )
    return first + (
        f'<details><summary>More about this result</summary>{rest}</details>' * bool(rest)
    )


def _effects(table: dict[str, Any]) -> str:
    if not table['effects']:
        return ''
    forms = {row['name']: row['form'] for row in calibrations(table) if row['taken']}
    found = [row['takes_off']['distance']['mean'] for row in table['effects'] if row['takes_off']]
    most, rows = max([0.0, *found]), []
    *named, (rest, *left) = attribution(table)
    for row, (name, *cells) in zip(table['effects'], named, strict=True):
        values = forms.get(row['name']) or ', '.join(
            f'{key} {value:.4g}' for key, value in row['parameters'].items()
        )
        off = row['takes_off']
        size = '' if off is None else bar(max(off['distance']['mean'], 0), None, most)
        rows.append(
            f'<tr><td><b>{escape(name)}</b></td>{_numbers(*cells)}<td>{size}</td>'
            f'<td class="values">{escape(values)}</td></tr>'
        )
    rows.append(f'<tr class="dim"><td>{rest}</td>{_numbers(*left)}<td></td><td></td></tr>')
    notes = ' '.join([*shown_by_one(table), poses_hide(table)])
    heads = ''.join(f'<th>{head}</th>' for head in (*HEADS, 'in all', 'parameters'))
    return (
        f'<div class="scroll"><table><tr>{heads}</tr>{"".join(rows)}</table></div>'
        f'<p><small>{escape(notes)}</small></p>'
        '<details><summary>What the columns mean</summary><p><small><b>Probability</b> that '
        'the camera has the effect. <b>Takes off</b>: by how much recordings are farther from the '
        'simulation when this effect is switched off and the others stay, mean over recordings '
        'with its 90 % interval; in all: depth, lost pixels and noise in tolerances. What '
        'effects take off need not add up: some do the same. <b>Not explained</b>: what is left, '
        'less what two runs of the simulator differ by. '
        '<code>flexx2 simulate --effects effects.yaml</code> and the camera node simulate these '
        'effects; docs/effects.md explains their parameters.</small></p></details>'
    )


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
    added = bool(camera_effects(table))
    rows = []
    for unit, (name, symbol, factor) in MEASURES.items():
        gap = table['gap'][unit]
        before, after, null = (gap[k] * factor for k in ('before', 'after', 'null'))
        shown = [before, after, null] if added else [before, null]
        rows.append(
            f'<tr><td>{escape(name)}</td>'
            f'{_numbers(*(f"{short(one, 3)} {symbol}" for one in shown))}'
            f'<td>{bar(before, after if added else None, null)}</td></tr>'
        )
    heads, fitted = '', ''
    if added:
        heads = '<th><span class="key blue"></span>with the effects</th>'
        data = 'the other recordings' if table['gap']['held_out'] else 'the same recording'
        fitted = f' The effects were fitted to {data}.'
    return (
        '<h2>How large the gap is</h2><div class="scroll"><table><tr><th>difference in</th>'
        f'<th><span class="key gray"></span>as simulated</th>{heads}'
        '<th><span class="key line"></span>two simulations</th><th></th></tr>'
        f'{"".join(rows)}</table></div><p><small>How much recordings and simulation differ, mean '
        f'over recordings: smaller is better.{fitted} Two simulations: two runs of the simulator '
        'with other noise, as an exact simulation would differ, too. Each row of '
        'bars has its own scale.'
        f'</small></p>{definitions(MEANINGS)}'
    )


def _where(table: dict[str, Any]) -> str:
    if not table['where']:
        found = 'No region differs by more than the tolerance.'
        if table['verdict'] == 'too_little':
            found = 'Too few depths to compare.'
        return f'<h2>Where the gap lies</h2><p>{found}</p>'
    listed = table['where'][:12]
    rows = ''.join(
        f'<tr><td>{escape(group(cell))}</td><td>{escape(difference(cell))}'
        f'{_doubt(cell["q_value"])}</td></tr>'
        for cell in listed
    )
    doubts = ''
    if any(cell['q_value'] > _DOUBTFUL for cell in listed):
        doubts = (
            f' May be chance: q is above {_DOUBTFUL:g}. It is the probability that noise alone '
            'differs so much in the first row, and the false discovery rate (Benjamini and '
            'Hochberg) in the others.'
        )
    more = len(table['where']) - 12
    others = f' diagnosis.json has {more} more rows.' if more > 0 else ''
    return (
        '<h2>Where the gap lies</h2><div class="scroll"><table><tr><th>pixels</th>'
        f'<th>real minus simulated</th></tr>{rows}</table></div>'
        f'<p><small>Mean over the pixels that differ.{doubts}{others}</small></p>'
    )


def _doubt(q: float) -> str:
    return f' <small>may be chance: q = {q:.2g}</small>' if q > _DOUBTFUL else ''


def _considered(table: dict[str, Any], decision: Decision) -> str:
    rows = []
    taken, refused = {row['name'] for row in table['effects']}, refusals(table)
    ties = {other['name'] for other in table['alternatives']}
    for one in decision.considered[:10]:
        name = one.fit.candidates[0].effect
        fraction = max(decision.base.total - one.fit.total, 0) / decision.excess
        if name in taken:
            why = 'selected'
        elif name in refused:
            why = f'found, but not named: {REFUSED[refused[name]]}'
        elif name in ties and (taken or refused):
            why = 'alternative explanation: may be present'
            why += ' instead of a selected effect' if taken else ''
        elif one.gain <= 0:
            why = 'no better on recordings that were left out of the fit'
        else:
            why = 'improves the fit less' if taken or refused else 'improves the fit too little'
        rows.append(
            f'<tr><td>{escape(spaced(name))}</td><td>{percent(min(fraction, 1))}</td>'
            f'<td>{escape(why)}</td></tr>'
        )
    return (
        '<h2>Effects that were considered</h2><div class="scroll"><table><tr><th>effect</th>'
        '<th>alone, improves the fit by</th><th>result</th></tr>'
        f'{"".join(rows)}</table></div><p><small>The other effects improve the fit even less.'
        '</small></p>' + ''.join(f'<p>{escape(line)}</p>' for line in not_considered(table))
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
        '<h2>Recordings</h2><div class="scroll"><table><tr><th>file</th><th>frames, camera</th>'
        '<th>fitted pose minus given pose: right, down, forward; pitch, yaw, roll</th></tr>'
        f'{"".join(rows)}</table></div>'
    )
