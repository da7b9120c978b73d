"""Sentences that describe a diagnosis."""

from collections.abc import Iterable, Sequence
from typing import Any

from flexx2_sim_ros.effects import of_role
from flexx2_sim_ros.errors import each_once
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.report.age import age_words
from flexx2_sim_ros.gap.report.places import CHANNELS, finding
from flexx2_sim_ros.gap.report.text import listed, moved, percent, short, spaced

# Names of the physical measures, for people: name, unit and factor to it.
MEASURES = {
    'wasserstein_mm': ('depth errors', 'mm', 1.0),
    'wasserstein_sigma': ('depth errors / noise', '', 1.0),
    'edge_sigma': ('depth errors / noise at edges', '', 1.0),
    'invalid_rate': ('invalid pixels', '%', 100.0),
    'log_variance': ('noise variance (ln)', '', 1.0),
    'correlation': ('correlation of neighbours', '', 1.0),
    'lag': ('correlation with frame before', '', 1.0),
    'kl_nats': ('shape of the errors (KL)', 'nats', 1.0),
}
# What they mean, for a reader who sees them for the first time.
_MEANINGS = (
    'how far depth errors must be moved to get from one distribution to the other, on average '
    '(Wasserstein distance), in 12 regions of the image',
    'the same, with each error divided by the noise that the simulation gives its pixel (sigma_z)',
    'the same, at depth jumps and sharp bends only',
    'difference of the fraction of pixels without depth',
    'difference of the logarithm of the variance over time: 0.1 is 10 % more or less variance',
    'difference of the correlation of the noise with the next pixel',
    'difference of the correlation of the noise with the frame before (lag 1)',
    'Kullback-Leibler divergence of the distributions of errors / noise: 0 is the same '
    'distribution',
)
MEANINGS = dict(zip((name for name, *_ in MEASURES.values()), _MEANINGS, strict=True))
SIZES = (
    'How much recordings and simulation differ, mean over recordings: smaller is better. Two '
    'simulations: two runs of the simulator with other noise, as an exact simulation would '
    'differ, too. -: not measured. Each row of bars has its own scale.'
)
_POSES_HIDE = (
    'Poses of unknown accuracy take over offsets, drifts and scales of depth. If you know how '
    'accurate yours are, diagnose again with --pose-prior.'
)
_NO_GAP = 'No gap above the tolerance'
_HIDDEN = 'the ground truth is not accurate enough to'
# Headlines of verdicts without effects.
_HEADLINES = {
    'none': f'{_NO_GAP}: the recordings look like the simulation.',
    'too_little': 'Too few depths of the recordings can be compared to say whether there is a '
    'gap.',
    'not_decidable': f'{_NO_GAP}, but {_HIDDEN} decide on {{hidden}}.',
    'unknown': 'There is a gap, and no effect of the catalogue explains it.',
    'hidden': f'There is a gap, but {_HIDDEN} tell its cause. Nearest explanations: {{nearest}}.',
}
# Why effects that were found are not named.
REFUSED = {
    'improbable': 'none of the effects found is probable enough',
    'little': 'the effects found explain too little of the gap',
    'hidden': 'an effect that the ground truth hides explains the gap about as well',
    'larger': 'the effects found make the gap larger when they are simulated',
}
_IMITATION = (
    'The named effects may only imitate a cause that is not in the catalogue: check them in other '
    'scenes with flexx2 gap check.'
)
_AT_GIVEN_POSES = (
    'The gap is measured at the given poses: in other scenes they are as wrong, and no effect of '
    'the simulation corrects them. The list of recordings says how far the fitted poses are from '
    'them.'
)
# What the reduction in percent counts.
_COUNTED = {
    'loss': 'In depth and invalid pixels the gap is below the tolerance. The percentage is '
    'therefore the improvement of the fit: in all that is compared, such as noise and '
    'correlations.',
    'distance': 'The percentage counts depth errors in units of the noise, and invalid pixels. '
    '100 % would be as close as two runs of the simulator.',
}
_SAME_NOISE = 0.02  # of sigma_z


def is_measured(unit: str, one: dict[str, Any]) -> bool:
    """Return whether the recordings show a measure; single frames, for example, show no noise."""
    return unit == 'invalid_rate' or any(one[key] for key in ('before', 'after', 'null'))


def _names(rows: Iterable[dict[str, Any]]) -> str:
    return listed([row['name'] for row in rows])


def camera_effects(table: dict[str, Any]) -> list[str]:
    """Return the names of the effects that change images: all but an error of the poses."""
    return [row['name'] for row in table['effects'] if row['name'] != of_role('pose').name]


def blames_poses(table: dict[str, Any]) -> bool:
    """Return whether the named effects are an error of the poses, and others that do little."""
    if not camera_effects(table):
        return True
    if table['effects'][0]['name'] != of_role('pose').name:
        return False
    return bool(table['gap']['at_fitted_poses']['shrink'] < 0.05)


def imitation(table: dict[str, Any]) -> list[str]:
    """Return a warning where named effects may stand for a cause that is not in the catalogue."""
    return [_IMITATION] if table['verdict'] == 'partly' and camera_effects(table) else []


def calibrations(table: dict[str, Any], taken: bool = False) -> list[dict[str, Any]]:
    """Return the forms that were tried, or those of them that were `taken`."""
    rows: list[dict[str, Any]] = (table['calibration'] or {}).get('effects', [])
    return [row for row in rows if row['taken'] or not taken]


def constants_of(table: dict[str, Any]) -> list[str]:
    """Return the named effects whose form hardly varies with what they are a function of."""
    return [
        row['name'] for row in calibrations(table) if row.get('varies', 1.0) < THRESHOLDS.varies
    ]


def headline(table: dict[str, Any]) -> str:
    """Return the verdict in one sentence."""
    gap, rows, verdict = table['gap'], table['effects'], table['verdict']
    if verdict == 'unknown' and _hides_cause(table):
        verdict = 'hidden'
    if verdict in _HEADLINES:
        hidden, nearest = table.get('not_decidable', ()), table.get('alternatives', ())
        return _HEADLINES[verdict].format(hidden=_names(hidden), nearest=_names(nearest))
    rest = ''
    if verdict == 'partly':
        # The little that is left, or what a typical form leaves, may be the form's own fault.
        most = gap['shrink'] >= THRESHOLDS.identified or calibrations(table, taken=True)
        rest = f' Another cause {"may remain" if most else "remains"}.'
    if blames_poses(table):
        return f'The poses of the cameras are wrong: correct them first.{rest}'
    simulated = camera_effects(table)
    them = 'it' if len(rows) == 1 else 'them'
    if len(simulated) < len(rows):
        them = listed(simulated)
        fitted = moved(gap['at_fitted_poses']['shrink'], 'what is left')
        rest = f' Once the poses are corrected, it {fitted}.{rest}'
    added = f'The gap {_due(rows)}: adding {them}'
    if gap['shrink'] < 0:
        what = 'makes the misfit'
        if gap['measured_by'] == 'distance':
            what = 'explains other features, but the gap in depth and invalid pixels becomes'
        return f'{added} to the simulation {what} {percent(-gap["shrink"])} larger.{rest}'
    removed = ': '.join(filter(None, [f'{percent(gap["shrink"])} of the gap', _changes(gap)]))
    return f'{added} to the simulation removes {removed}.{rest}'


def _due(rows: Sequence[dict[str, Any]]) -> str:
    # Only a likely effect is said to be the cause.
    likely = [row for row in rows if row['confidence'] >= THRESHOLDS.likely]
    others = [row for row in rows if row not in likely]
    if not likely:
        return f'may be due to {_names(rows)}'
    also = f', and may be due to {_names(others)} as well' if others else ''
    return f'is due to {_names(likely)}{also}'


def significance(table: dict[str, Any]) -> list[str]:
    """Return the p-value of the simulation being the camera, as text; nothing without one."""
    value = table['gap'].get('p_value')
    return [] if value is None else [f'p = {short(value)} for "no gap"']


def _hides_cause(table: dict[str, Any]) -> bool:
    # Whether an effect that the ground truth hides may be the cause of an unknown gap.
    hidden = {row['name'] for row in table['not_decidable']}
    larger = 'larger' in refusals(table).values()
    return not larger and bool(hidden & {row['name'] for row in table['alternatives']})


def refusals(table: dict[str, Any]) -> dict[str, str]:
    """Return why effects that were found are not named, by effect; none in older tables."""
    return {row['name']: row['reason'] for row in table.get('refused', [])}


def _unnamed(table: dict[str, Any]) -> list[str]:
    # What was found where the cause is unknown, and what else may be present.
    refused = refusals(table)
    out = [
        f'Found, but not named: {listed([*refused])}: {REFUSED[reason]}.'
        for reason in dict.fromkeys(refused.values())
    ]
    others = [row for row in table['alternatives'] if row['name'] not in refused]
    if others and not _hides_cause(table):  # Otherwise the headline has them.
        out.append(f'{"Other" if refused else "Nearest"} explanations: {_names(others)}.')
    return out


def _changes(gap: dict[str, Any]) -> str:
    # What is reduced, in physical units; empty where it is below the tolerance in these.
    parts = []
    for unit in ('wasserstein_mm', 'invalid_rate'):
        name, symbol, factor = MEASURES[unit]
        before, after, null = (factor * gap[unit][key] for key in ('before', 'after', 'null'))
        if before - null > factor * gap[unit]['tolerance']:
            parts.append(f'{name} {short(before)} -> {short(after)} {symbol}')
    return ', '.join(parts)


def sentences(table: dict[str, Any]) -> list[str]:
    """Return the details below the headline, one line each, those of a first screen first."""
    gap, named, out = table['gap'], table['effects'], list[str]()
    if table['where'] and table['verdict'] != 'none':
        out.append(finding(table['where'][0]))
    if table['verdict'] == 'unknown':
        out = [*_unnamed(table), *out]
    if camera_effects(table):
        out = [*imitation(table), *out, *reduction(gap)[1:]]  # The first is in the table.
        out += [*_noise_level(gap['noise_factor']), *_calibrated(table)]
    if len(camera_effects(table)) < len(named):
        out.append(_AT_GIVEN_POSES)
    for other in table['alternatives'] if named else ():
        instead = f' instead of {listed(other["instead_of"])}' if len(named) > 1 else ''
        out.append(f'Alternative explanation: {_names([other])}{instead}.')
    if table['verdict'] in ('unknown', 'partly') and table['unexplained']:
        names = ', '.join(CHANNELS[row['structure']] for row in table['unexplained'][:4])
        rest = 'The gap' if table['verdict'] == 'unknown' else 'The remaining gap'
        if calibrations(table, taken=True):
            rest = 'Before curves and tables were fitted, the remaining gap'
        out.append(f'{rest} shows in: {names}.')
    if 'patch' in table:
        out += correction(table)
    truths = [row['truth'] for row in table['recordings'] if row['used']]
    truth = accuracy(truths)
    out += [f'Accuracy of the ground truth: {truth}.'] if truth else []
    free = any(one['pose'] is None and not one['planes'] for one in truths)
    if free and len(named) > 1 and not table['settings']['pose_stated']:
        out.append(_POSES_HIDE)
    return out + not_decidable(table) + age_words(table['age'])


def _calibrated(table: dict[str, Any]) -> list[str]:
    # Which effects have another form than that of the catalogue.
    same = [
        f'{spaced(name)}: its fitted form is about the same everywhere in these recordings. '
        'A cause that does not depend on the same quantity may do this as well.'
        for name in constants_of(table)
    ]
    taken = calibrations(table, taken=True)
    if not taken:
        return same
    forms = ', '.join(f'{spaced(row["name"])} ({row["form"]})' for row in taken)
    typical, other = table['calibration']['typical_gap'], ''
    if typical['measured_by'] == table['gap']['measured_by']:
        removed = moved(typical['shrink'], 'the gap', '')
        other = f' In the form of the catalogue, the effects would {removed}.'
    dropped = [
        f'{spaced(name)}: left out; it made up for what the diagnosed lens did not explain.'
        for name in table['calibration']['dropped']
    ]
    return [f'Calibrated: {forms}, fitted to these recordings.{other}', *dropped, *same]


def reduction(gap: dict[str, Any]) -> list[str]:
    """Return sentences on the reduction of the gap in physical units, and on what gets worse."""
    out = [difference(gap), _COUNTED[gap['measured_by']]]
    if gap['held_out']:
        out.append(
            'Each recording was compared with effects that were fitted to the others. Where '
            'poses can hide errors of an effect, it has errors as large as those of its fit. '
            f'{_elsewhere(gap["interval"])}'
        )
    if 'note' in gap:
        out.append(gap['note'][0].upper() + gap['note'][1:] + '.')
    if gap['worse']:
        names = ', '.join(MEASURES[unit][0] for unit in gap['worse'])
        out.append(f'The effects make this worse: {names}.')
    return out


def _elsewhere(interval: list[float] | None) -> str:
    # The reduction to expect on other scenes.
    if interval is None:
        return 'Two recordings are too few for an interval of the reduction.'
    low, high = map(percent, interval)
    text = f'On other scenes, expect a reduction of {low} to {high} (90 % interval).'
    if interval[0] < 0:
        text += (
            ' Below 0 %, the effects make the gap larger: these recordings do not rule that out. '
            'More recordings make the interval narrower.'
        )
    return text


def correction(table: dict[str, Any]) -> list[str]:
    """Return sentences on a correction without a cause: what it does when it is simulated."""
    patch = table['patch']
    better, worse = (
        listed([name for unit, (name, *_) in MEASURES.items() if patch[unit][key]]) or 'nothing'
        for key in ('better', 'worse')
    )
    what = f'correction of bias, noise and invalid pixels by {spaced(patch["covariate"])}'
    return [
        f'effects.yaml has a {what} instead (residual_patch). It is no cause, and may fail in '
        'other scenes.'
        if patch['offered']
        else f'A {what} was simulated and left out: it does not clearly bring the simulation '
        'nearer to the recordings.',
        difference(patch, 'the correction'),
        f'The correction makes this better: {better}. It makes this worse: {worse}.',
        'Each recording was compared with a correction that was fitted to the others.'
        if patch['held_out']
        else 'The correction was fitted to the one recording that it is compared with.',
        *_noise_level(table['gap']['noise_factor']),
    ]


def difference(gap: dict[str, Any], added: str = 'the effects') -> str:
    """Return how far recordings and simulation are apart, in physical units, in one sentence."""
    invalid = gap['invalid_rate']
    lost = max(invalid['before'], invalid['after']) > invalid['tolerance']
    shown = ('wasserstein_mm', 'invalid_rate')[: 1 + lost]
    units = [(unit, MEASURES[unit]) for unit in shown]
    before, after, null = (
        ', '.join(f'{name} {short(f * gap[unit][key])} {u}' for unit, (name, u, f) in units)
        for key in ('before', 'after', 'null')
    )
    return (
        f'The gap is the difference between recordings and simulation: {before}. With {added} '
        f'it is: {after}. Two runs of the simulator differ by: {null}.'
    )


def _noise_level(factor: float) -> list[str]:
    # Cameras of one kind differ by some percent.
    more = factor - 1
    if abs(more) < _SAME_NOISE:
        return []
    return [
        f'The noise of this camera is {percent(abs(more))} {"above" if more > 0 else "below"} the '
        "model's. It is so in these simulations, and not in effects.yaml."
    ]


def _by(rows: Iterable[dict[str, Any]], key: str) -> Iterable[tuple[str, str]]:
    # What rows have in common, and the names of those that have it.
    by: dict[str, list[str]] = {}
    for row in rows:
        by.setdefault(row[key], []).append(row['name'])
    return ((what, listed(names)) for what, names in by.items())


def not_decidable(table: dict[str, Any]) -> list[str]:
    """Return the undecidable effects, one line for each measurement that would decide."""
    return [
        f'Not decidable with this ground truth: {names}. This would decide: {what}.'
        for what, names in _by(table['not_decidable'], 'settled_by')
    ]


def not_considered(table: dict[str, Any]) -> list[str]:
    """Return the effects that were not considered, one line for each reason."""
    return [
        f'Not considered: {names}: {reason}.'
        for reason, names in _by(table['not_considered'], 'reason')
    ]


def accuracy(truths: Sequence[dict[str, Any]]) -> str:
    """Return the accuracy of the ground truth as text; empty if it is taken as exact."""

    def span(key: str, unit: str, factor: float = 1.0) -> str:
        # Empty where no recording says it, or all say it is exact.
        values = [factor * one[key] for one in truths if one[key] is not None]
        low, high = (short(end(values, default=0), 3) for end in (min, max))
        size = low if low == high else f'{low} to {high}'
        return '' if high == '0' else f'{size} {unit}'

    def both(*some: str) -> str:
        return ' and '.join(filter(None, some))

    said = {
        '{} of the pixels unknown': span('unknown', '%', 100),
        'depth known to {}': span('sigma', 'mm', 1000),
        'pose to {}': both(span('pose', 'mm', 1000), span('turn', 'deg')),
        'planes to {}': both(span('offset', 'mm', 1000), span('tilt', 'deg')),
    }
    return ', '.join(words.format(size) for words, size in said.items() if size)


def on_recordings(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return why recordings were left out, and notes on the others: each reason and note once."""
    left_out = each_once((row['name'], row['reason']) for row in rows if not row['used'])
    notes = each_once((row['name'], note) for row in rows if row['used'] for note in row['notes'])
    return [f'Left out: {reason}.' for reason in left_out] + [f'Note: {note}.' for note in notes]
