"""The report of a diagnosis: one HTML page that needs no other file."""

from collections.abc import Sequence
import re
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.effects import loadable
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.forms.calibrating import Calibrated
from flexx2_sim_ros.gap.inference.decide import Decision
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.report import words
from flexx2_sim_ros.gap.report.charts import charts, forms, maps
from flexx2_sim_ros.gap.report.cost_page import section
from flexx2_sim_ros.gap.report.frames import frames, FRAMES_STYLE
from flexx2_sim_ros.gap.report.places import difference, group
from flexx2_sim_ros.gap.report.sizes import (
    attribution,
    HEADS,
    lengths,
    processed_section,
    said,
    sizes_section,
)
from flexx2_sim_ros.gap.report.text import percent, short, spaced
from flexx2_sim_ros.html_drawing import part_bar
from flexx2_sim_ros.html_page import html_page

_STYLE = (
    FRAMES_STYLE
    + """
.attribution td:not(:last-child), .sizes td + td { white-space: nowrap; }
.attribution .bar { width: 8rem; } .attribution .dim rect { fill: var(--gray); }
.attribution tr:last-child td { border-top: 1px solid var(--line); }
.attribution td:last-child { min-width: 11rem; }
body > details > summary { font-size: 1.1rem; font-weight: 600; margin: .5rem 0; }
@media (max-width: 40rem) { .attribution .bar { width: 4.5rem; } }
"""
)
# Words and tag of each verdict.
_VERDICTS = {
    'none': ('no gap', 'good'),
    'identified': ('cause identified', 'named'),
    'partly': ('partly explained', 'doubtful'),
    'unknown': ('cause unknown', ''),
    'not_decidable': ('not decidable', 'doubtful'),
    'too_little': ('too little data', ''),
}
_MEANING = html.Html(
    '<b>Probability</b> that the camera has the effect. <b>Takes off</b>: by how much the '
    'simulation comes nearer when the effect is switched on, mean over one order of the effects '
    'and its reverse, and over recordings, with its 90 % interval. The rows add up to the last '
    'one. Noise: its variance and correlations, in tolerances (-: not measured); bars: depth and '
    'lost pixels, in tolerances. <b>Absorbed by poses</b>: what the fitted poses take off, and '
    'poses in other scenes do not. <b>Not explained</b>: what is left, less what two simulations '
    'differ by. <code>flexx2 simulate --effects effects.yaml</code> and the camera node simulate '
    'these effects; docs/effects.md explains their parameters.'
)
_MOST_PLACES = 12
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
    told = ', '.join([f'from {used} recording{"s" * (used != 1)}', *words.significance(table)])
    explained = bool(words.camera_effects(table))
    taken = [one for one in calibrated.explained.verdicts if one.taken] if calibrated else []
    first, rest = said(table)
    body = [
        html.element(
            'p', html.tag(*_VERDICTS[table['verdict']]), ' ', html.element('small', told)
        ),
        html.heading(_typeset(words.headline(table)), 1),
        _effects(table),
        html.paragraphs(first),
        html.folded('What the columns mean', html.note(_MEANING)) if table['effects'] else '',
        html.folded('More about this result', html.paragraphs(rest)) if rest else '',
        forms(taken, calibrated.explained.looked) if calibrated and taken else '',
        sizes_section(table),
        processed_section(table) if 'processed' in table else '',
        section(table['cost']) if 'cost' in table else '',
        _where(table),
        frames(table, confirmed, model.evidence[0].axes),
        maps(confirmed, explained),
        charts(model.evidence, confirmed, explained),
        _considered(table, decision),
        _recordings(table),
        html.made_by(table, 'docs/diagnosis.md'),
    ]
    return html_page(f'Sim-to-real gap: {table["verdict"]}', _STYLE, '\n'.join(body))


def _typeset(text: str) -> str:
    # With arrows, and no line break before a unit.
    return re.sub(r'(?<=\d) (?=%|mm)', '\u00a0', text).replace('->', '\u2192')


def _effects(table: dict[str, Any]) -> html.Html:
    if not table['effects']:
        return html.Html()
    fitted = {row['name']: row['form'] for row in words.calibrations(table, taken=True)}
    values = [fitted.get(row['name']) or _parameters(row) for row in table['effects']]
    sizes, rows = lengths(table), []
    for i, ((name, sure, *cells), size) in enumerate(zip(attribution(table), sizes, strict=True)):
        drawn = part_bar(size, sizes[-1])
        named = i < len(values)
        what = html.element('b', name) if named else name
        told = values[i] if named else ''
        rows.append(html.row([what, drawn, *cells, sure, told], '' if named else 'dim'))
    return html.table((HEADS[0], 'part', *HEADS[2:], HEADS[1], 'parameters'), rows, 'attribution')


def _parameters(row: dict[str, Any]) -> str:
    units = {one.name: one.unit for one in loadable()[row['name']].parameters()}
    told = (f'{key} {short(v, 4)} {units.get(key, "")}' for key, v in row['parameters'].items())
    return ', '.join(map(str.strip, told))


def _where(table: dict[str, Any]) -> html.Html:
    title, listed = 'Where the gap lies', table['where'][:_MOST_PLACES]
    if not listed:
        found = 'No region differs by more than the tolerance.'
        if table['verdict'] == 'too_little':
            found = 'Too few depths to compare.'
        return html.folded(title, html.element('p', found))
    rows, note = [], 'Mean over the pixels that differ.'
    for cell in listed:
        chance = f' may be chance: q = {short(cell["q_value"])}'
        doubt = html.element('small', chance) if cell['q_value'] > _DOUBTFUL else ''
        rows.append((group(cell), html.join(difference(cell), doubt)))
    if any(cell['q_value'] > _DOUBTFUL for cell in listed):
        note += (
            f' May be chance: q is above {_DOUBTFUL:g}. It is the probability that noise alone '
            'differs so much in the first row, and the false discovery rate (Benjamini and '
            'Hochberg) in the others.'
        )
    more = len(table['where']) - len(listed)
    if more:
        note += f' diagnosis.json has {more} more rows.'
    heads = ['pixels', 'real minus simulated']
    return html.folded(title, html.table(heads, rows), html.note(note))


def _considered(table: dict[str, Any], decision: Decision) -> html.Html:
    rows = []
    taken, refused = {row['name'] for row in table['effects']}, words.refusals(table)
    why = dict.fromkeys(taken, 'selected')
    why |= {name: f'found, but not named: {words.REFUSED[key]}' for name, key in refused.items()}
    if why:
        instead = ' instead of a selected effect' if taken else ''
        tie = f'alternative explanation: may be present{instead}'
        why = {**{other['name']: tie for other in table['alternatives']}, **why}
    less = f'improves the fit {"less" if taken or refused else "too little"}'
    for one in decision.considered[:10]:
        name = one.fit.candidates[0].effect
        fraction = max(decision.base.total - one.fit.total, 0) / decision.excess
        usual = less if one.gain > 0 else 'no better on recordings that were left out of the fit'
        rows.append([spaced(name), percent(min(fraction, 1)), why.get(name, usual)])
    return html.folded(
        'Effects that were considered',
        html.table(['effect', 'alone, improves the fit by', 'result'], rows),
        html.note('The other effects improve the fit even less.'),
        html.paragraphs(words.not_considered(table)),
    )


def _recordings(table: dict[str, Any]) -> html.Html:
    rows = []
    for row in table['recordings']:
        if not row['used']:
            rows.append([row['name'], 'left out', row['reason']])
            continue
        shift = ', '.join(f'{1000 * metres:+.1f}' for metres in row['pose'][:3])
        turn = ', '.join(f'{angle:+.2f}' for angle in row['pose'][3:])
        kind = 'moving' if row['moving'] else 'still'
        truth = words.accuracy([row['truth']])
        lines = [f'ground truth: {truth}'] * bool(truth) + row['notes']
        notes = [
            part for one in lines for part in (html.element('br'), html.element('small', one))
        ]
        pose = html.join(f'{shift} mm; {turn} deg', *notes)
        rows.append([row['name'], f'{row["frames"]} frames, {kind}', pose])
    heads = (
        'file',
        'frames, camera',
        'fitted pose minus given pose: right, down, forward; pitch, yaw, roll',
    )
    return html.folded('Recordings', html.table(heads, rows))
