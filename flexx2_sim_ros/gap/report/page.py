"""The report of a diagnosis: one HTML page that needs no other file."""

from collections.abc import Sequence
from html import escape
from typing import Any

from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.features.physical import UNITS
from flexx2_sim_ros.gap.inference.decide import Decision
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.report.charts import charts, maps
from flexx2_sim_ros.gap.report.drawing import bar
from flexx2_sim_ros.gap.report.words import headline, not_considered, place, sentences
from flexx2_sim_ros.html_page import html_page

_STYLE = """
td, th { padding: .18rem .9rem .18rem 0; text-align: left; vertical-align: top; }
th { color: #5a6b7b; }
.tag { display: inline-block; padding: .1rem .6rem; border-radius: 1rem; color: #fff;
  font-weight: 600; }
.none { background: #2e7d4f; } .identified { background: #1f6feb; }
.partly { background: #b7791f; } .unknown { background: #a8324a; }
.row { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.row figure { margin: 0; max-width: 27.5rem; }
figcaption { font-size: .85rem; } small, .dim, figcaption { color: #5a6b7b; }
code { background: #f2f5f8; padding: 0 .25rem; }
"""
_UNIT_NAMES = {
    'wasserstein_mm': ('distance of depth errors (Wasserstein-1)', 'mm', 1.0),
    'invalid_rate': ('difference in invalid pixels', '%', 100.0),
    'kl_nats': ('divergence of normalised errors', 'nats', 1.0),
    'correlation': ("difference in neighbours' correlation", '', 1.0),
}


def page(
    table: dict[str, Any], model: Model, decision: Decision, confirmed: Sequence[Outcome]
) -> str:
    """Return the page as HTML, all text escaped and all pictures inside."""
    body = [
        f'<p><span class="tag {escape(table["verdict"])}">{escape(table["verdict"])}</span> '
        f'<small>{sum(r["used"] for r in table["recordings"])} recordings</small></p>',
        f'<h1>{escape(headline(table))}</h1>',
        ''.join(f'<p>{escape(line)}</p>' for line in sentences(table)),
        _effects(table),
        _shrinkage(table),
        _where(table),
        maps(confirmed, bool(table['effects'])),
        charts(confirmed, bool(table['effects'])),
        _considered(table, decision),
        _recordings(table),
    ]
    body.append(
        f'<p class="dim">flexx2_sim_ros {table["version"]}, {table["seconds"]:.0f} s, '
        f'{table["peak_mb"]:.0f} MB. Losses are in units of the tolerance; see '
        'docs/diagnosis.md.</p>'
    )
    return html_page(f'Sim-to-real gap: {table["verdict"]}', _STYLE, '\n'.join(body))


def _effects(table: dict[str, Any]) -> str:
    if not table['effects']:
        return ''
    rows = []
    for row in table['effects']:
        values = ', '.join(f'{name} {value:.4g}' for name, value in row['parameters'].items())
        low, high = row['interval']
        rows.append(
            f'<tr><td><b>{escape(row["name"].replace("_", " "))}</b></td>'
            f'<td>{row["share"]:.0%}</td><td>{low:.0%} to {high:.0%}</td>'
            f'<td>{row["confidence"]:.0%}</td><td>{escape(values)}</td></tr>'
        )
    return (
        '<h2>What causes the gap</h2><table><tr><th>effect</th><th>fraction of the gap</th>'
        '<th>90 % interval</th><th>confidence</th><th>parameters</th></tr>'
        f'{"".join(rows)}</table><p><small>effects.yaml has these effects, for <code>flexx2 '
        'simulate --effects</code> and the camera node.</small></p>'
    )


def _shrinkage(table: dict[str, Any]) -> str:
    rows = []
    for unit in UNITS:
        name, symbol, factor = _UNIT_NAMES[unit]
        gap = table['gap'][unit]
        first, last, least = (gap[k] * factor for k in ('before', 'after', 'null'))
        rows.append(
            f'<tr><td>{escape(name)}</td><td>{first:.3g} {symbol}</td>'
            f'<td>{last:.3g} {symbol}</td><td>{least:.3g} {symbol}</td>'
            f'<td>{bar(first, last, least)}</td></tr>'
        )
    after = 'with the effects' if table['effects'] else 'after (no effect added)'
    return (
        f'<h2>How large the gap is</h2><table><tr><th></th><th>as simulated</th><th>{after}</th>'
        '<th>two simulations</th><th></th></tr>' + ''.join(rows) + '</table>'
    )


def _where(table: dict[str, Any]) -> str:
    if not table['where']:
        return '<h2>Where the gap lies</h2><p>No region differs by more than the tolerance.</p>'
    rows = ''.join(
        f'<tr><td>{escape(place(cell))}</td><td><small>q = {cell["q_value"]:.2g}</small></td></tr>'
        for cell in table['where'][:12]
    )
    more = len(table['where']) - 12
    note = f'<p><small>and {more} more, in diagnosis.json</small></p>' if more > 0 else ''
    return f'<h2>Where the gap lies</h2><table>{rows}</table>{note}'


def _considered(table: dict[str, Any], decision: Decision) -> str:
    rows = []
    taken = {row['name'] for row in table['effects']}
    ties = {other['name'] for other in table['alternatives']}
    for one in decision.considered[:10]:
        name = one.fit.candidates[0].effect
        share = max(decision.base.total - one.fit.total, 0) / decision.excess
        if name in taken:
            why = 'selected'
        elif name in ties and taken:
            why = 'alternative explanation: cannot be distinguished from a selected effect'
        elif one.gain <= 0:
            why = 'explains nothing on recordings that were left out of the fit'
        else:
            why = 'explains less' if taken else 'explains too little'
        rows.append(
            f'<tr><td>{escape(name.replace("_", " "))}</td><td>{min(share, 1):.0%}</td>'
            f'<td>{escape(why)}</td></tr>'
        )
    return (
        '<h2>Effects that were considered</h2><table><tr><th>effect, alone</th><th>fraction of '
        f'the gap</th><th></th></tr>{"".join(rows)}</table><p><small>The other effects explain '
        'even less.</small></p>'
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
            notes = ''.join(f'<br><small>{escape(note)}</small>' for note in row['notes'])
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
        '<h2>Recordings</h2><table><tr><th></th><th></th><th>fitted pose error (right, down, '
        f'forward; pitch, yaw, roll)</th></tr>{"".join(rows)}</table>'
    )
