"""Sentences that describe a diagnosis."""

from typing import Any

from flexx2_sim_ros.effects import of_role
from flexx2_sim_ros.errors import each_once
from flexx2_sim_ros.gap.report.age import age_words
from flexx2_sim_ros.gap.report.places import CHANNELS, finding
from flexx2_sim_ros.gap.report.text import listed, percent, spaced

# Names of the physical measures, for people: name, unit and factor to it.
MEASURES = {
    'wasserstein_mm': ('depth errors (Wasserstein-1)', 'mm', 1.0),
    'wasserstein_sigma': ('depth errors in sigma_z', '', 1.0),
    'edge_sigma': ('depth errors at edges in sigma_z', '', 1.0),
    'invalid_rate': ('invalid pixels', '%', 100.0),
    'log_variance': ('noise (log variance)', '', 1.0),
    'correlation': ('correlation of neighbours', '', 1.0),
    'lag': ('correlation with the frame before', '', 1.0),
    'kl_nats': ('divergence of normalised errors', 'nats', 1.0),
}


def _names(rows: list[dict[str, Any]]) -> str:
    return listed([row['name'] for row in rows])


def camera_effects(table: dict[str, Any]) -> list[str]:
    """Return the names of the effects that change images: all but an error of the poses."""
    return [row['name'] for row in table['effects'] if row['name'] != of_role('pose').name]


def calibrations(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the forms that were tried; none if nothing was calibrated."""
    rows: list[dict[str, Any]] = (table['calibration'] or {}).get('effects', [])
    return rows


def _taken(table: dict[str, Any]) -> list[dict[str, Any]]:
    return [row for row in calibrations(table) if row['taken']]


def headline(table: dict[str, Any]) -> str:
    """Return the verdict in one sentence."""
    gap, rows = table['gap'], table['effects']
    if table['verdict'] == 'none':
        return 'No gap above the tolerance: the recordings look like the simulation.'
    if table['verdict'] == 'not_decidable':
        return (
            'No gap above the tolerance, but the ground truth is not accurate enough to decide '
            f'on {_names(table["not_decidable"])}.'
        )
    if table['verdict'] == 'too_little':
        return 'The recordings have too few depths on surfaces to say whether there is a gap.'
    if table['verdict'] == 'unknown':
        hidden = {row['name'] for row in table['not_decidable']}
        if hidden & {row['name'] for row in table['alternatives']}:
            return (
                'There is a gap, but the ground truth is not accurate enough to tell its cause. '
                f'Nearest explanations: {_names(table["alternatives"])}.'
            )
        return 'There is a gap, and no effect of the catalogue explains it.'
    rest = ''
    if table['verdict'] == 'partly':
        # What a typical form leaves may be the form's own fault.
        sure = 'may remain' if _taken(table) else 'remains'
        rest = f' Another cause {sure}.'
    if not camera_effects(table) or (
        rows[0]['name'] == of_role('pose').name and gap['shrink'] < 0.05
    ):
        return f'The poses of the cameras are wrong: correct them first.{rest}'
    added = f'The gap is due to {_names(rows)}: adding {"it" if len(rows) == 1 else "them"}'
    if gap['shrink'] < 0:
        return (
            f'{added} to the simulation explains other features, but the gap in depth and invalid '
            f'pixels becomes {percent(-gap["shrink"])} larger.{rest}'
        )
    removed = ': '.join(filter(None, [f'{percent(gap["shrink"])} of the gap', _changes(gap)]))
    return f'{added} to the simulation removes {removed}.{rest}'


def _changes(gap: dict[str, Any]) -> str:
    # What is reduced, in physical units; empty where it is below the tolerance in these.
    parts = []
    for name, unit in (('depth errors', 'wasserstein_mm'), ('invalid pixels', 'invalid_rate')):
        _, symbol, factor = MEASURES[unit]
        before, after, null = (factor * gap[unit][key] for key in ('before', 'after', 'null'))
        if before - null > factor * gap[unit]['tolerance']:
            parts.append(f'{name} {before:.2g} -> {after:.2g} {symbol}')
    return ', '.join(parts)


def sentences(table: dict[str, Any]) -> list[str]:
    """Return the details below the headline, one line each."""
    out = []
    gap = table['gap']
    if camera_effects(table):
        out += reduction(gap) + _calibrated(table)
    if any(row['name'] == of_role('pose').name for row in table['effects']):
        out.append(
            'The gap is measured with the fitted pose of each recording; the list of recordings '
            'says how far this is from the given pose.'
        )
    if table['effects']:
        out += [
            f'Alternative explanation: {_names([other])}'
            + (f' instead of {listed(other["instead_of"])}.' if len(table['effects']) > 1 else '.')
            for other in table['alternatives']
        ]
    if table['verdict'] in ('unknown', 'partly') and table['unexplained']:
        names = ', '.join(CHANNELS[row['structure']] for row in table['unexplained'][:4])
        rest = 'The remaining gap'
        if _taken(table):
            rest = 'What effects in the form of the catalogue leave of the gap'
        out.append(f'{rest} shows in: {names}.')
    if 'patch' in table:
        out.append(
            f'effects.yaml has a correction without a cause, over '
            f'{spaced(table["patch"]["covariate"])}: it removes '
            f'{percent(table["patch"]["shrink"])} of the gap in bias, noise and invalid pixels.'
        )
    out += not_decidable(table) + ground_truth(table) + age_words(table['age'])
    if table['where'] and table['verdict'] != 'none':
        out.append(finding(table['where'][0]))
    return out


def _calibrated(table: dict[str, Any]) -> list[str]:
    # Which effects have another form than that of the catalogue.
    taken = _taken(table)
    if not taken:
        return []
    forms = '; '.join(f'{spaced(row["name"])}: {row["form"]}' for row in taken)
    removed = percent(table['calibration']['typical_gap']['shrink'])
    return [
        f'Calibrated: {forms}. In the form of the catalogue, the effects would remove {removed} '
        'of the gap.',
        *map(why_dropped, table['calibration']['dropped']),
    ]


def why_dropped(name: str) -> str:
    """Return why a pose error is left out beside a fitted lens."""
    return f'{spaced(name)}: left out; it made up for what the diagnosed lens did not explain.'


def difference(measures: dict[str, Any]) -> str:
    """Return how far recordings and simulation are apart, in physical units, in one sentence."""
    depth, invalid = measures['wasserstein_mm'], measures['invalid_rate']
    parts = [
        f'depth errors from {depth["before"]:.2g} to {depth["after"]:.2g} mm '
        f'({depth["null"]:.2g} mm between two simulations)'
    ]
    if max(invalid['before'], invalid['after']) > invalid['tolerance']:
        parts.append(
            f'invalid pixels from {100 * invalid["before"]:.2g} to {100 * invalid["after"]:.2g} %'
        )
    return f'Difference between recordings and simulation: {", ".join(parts)}.'


def reduction(gap: dict[str, Any]) -> list[str]:
    """Return sentences on the reduction of the gap in physical units, and on what gets worse."""
    out = [difference(gap)]
    if gap['held_out']:
        sure = 'Two recordings are too few for an interval of the reduction.'
        if gap['interval'] is not None:
            low, high = map(percent, gap['interval'])
            sure = f'90 % interval of the reduction: {low} to {high} of the gap.'
        out.append(
            f'Each recording was compared with effects that were fitted to the others. {sure}'
        )
    if 'note' in gap:
        out.append(gap['note'][0].upper() + gap['note'][1:] + '.')
    if gap['measured_by'] == 'loss':
        out.append(
            'In depth and invalid pixels the gap is below the tolerance. The reduction is '
            "therefore that of the loss of the diagnosis' features."
        )
    if gap['worse']:
        names = ', '.join(MEASURES[unit][0] for unit in gap['worse'])
        out.append(f'The effects make this worse: {names}.')
    return out


def not_decidable(table: dict[str, Any]) -> list[str]:
    """Return the undecidable effects, one line for each measurement that would decide."""
    by: dict[str, list[str]] = {}
    for row in table['not_decidable']:
        by.setdefault(row['settled_by'], []).append(row['name'])
    return [
        f'Not decidable with this ground truth: {listed(names)}. This would decide: {what}.'
        for what, names in by.items()
    ]


def ground_truth(table: dict[str, Any]) -> list[str]:
    """Return one line on the accuracy of the ground truth, or none if it is taken as exact."""
    said = accuracy([row['truth'] for row in table['recordings'] if row['used']])
    return [f'Accuracy of the ground truth: {said}.'] if said else []


def accuracy(truths: list[dict[str, Any]]) -> str:
    """Return the accuracy of the ground truth as text; empty if it is taken as exact."""

    def span(key: str, factor: float) -> str:
        values = [factor * one[key] for one in truths if one[key] is not None]
        low, high = f'{min(values):.3g}', f'{max(values):.3g}'
        return low if low == high else f'{low} to {high}'

    parts = []
    if any(one['unknown'] for one in truths):
        parts.append(f'{span("unknown", 100)} % of the pixels unknown')
    if any(one['sigma'] is not None for one in truths):
        parts.append(f'depth known to {span("sigma", 1000)} mm')
    if any(one['pose'] is not None for one in truths):
        parts.append(f'pose to {span("pose", 1000)} mm and {span("turn", 1)} deg')
    if any(one['planes'] for one in truths):
        parts.append(f'planes to {span("offset", 1000)} mm and {span("tilt", 1)} deg')
    return ', '.join(parts)


def remarks(table: dict[str, Any]) -> list[str]:
    """Return notes on recordings and on effects that were not considered, one line each."""
    return not_considered(table) + on_recordings(table['recordings'])


def on_recordings(rows: list[dict[str, Any]]) -> list[str]:
    """Return why recordings were left out, and notes on the others: each reason and note once."""
    left_out = each_once((row['name'], row['reason']) for row in rows if not row['used'])
    notes = each_once((row['name'], note) for row in rows if row['used'] for note in row['notes'])
    return [f'Left out: {reason}.' for reason in left_out] + [f'Note: {note}.' for note in notes]


def not_considered(table: dict[str, Any]) -> list[str]:
    """Return the effects that were not considered, one line for each reason."""
    reasons: dict[str, list[str]] = {}
    for row in table['not_considered']:
        reasons.setdefault(row['reason'], []).append(row['name'])
    return [f'Not considered: {listed(names)}: {reason}.' for reason, names in reasons.items()]
