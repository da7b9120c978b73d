"""Sentences that describe a diagnosis."""

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
_MEANINGS = {
    'wasserstein_mm': 'how far depth errors must be moved to get from one distribution to the '
    'other, on average (Wasserstein distance), in 12 regions of the image',
    'wasserstein_sigma': 'the same, with each error divided by the noise that the simulation '
    'gives its pixel (sigma_z)',
    'edge_sigma': 'the same, at depth jumps and sharp bends only',
    'invalid_rate': 'difference of the fraction of pixels without depth',
    'log_variance': 'difference of the logarithm of the variance over time: 0.1 is 10 % more or '
    'less variance',
    'correlation': 'difference of the correlation of the noise with the next pixel',
    'lag': 'difference of the correlation of the noise with the frame before (lag 1)',
    'kl_nats': 'Kullback-Leibler divergence of the distributions of errors / noise: 0 is the '
    'same distribution',
}
MEANINGS = {MEASURES[key][0]: meaning for key, meaning in _MEANINGS.items()}
SIZES = (
    'How much recordings and simulation differ, mean over recordings: smaller is better. Two '
    'simulations: two runs of the simulator with other noise, as an exact simulation would '
    'differ, too. Each row of bars has its own scale.'
)
_POSES_HIDE = (
    'Poses that may be wrong by any amount take over offsets, drifts and scales of depth. If you '
    'know how accurate yours are, diagnose again with --pose-prior.'
)
# Why effects that were found are not named.
REFUSED = {
    'improbable': 'none of the effects found is probable enough',
    'little': 'the effects found explain too little of the gap',
    'hidden': 'an effect that the ground truth hides explains the gap about as well',
    'larger': 'the effects found make the gap larger when they are simulated',
}
_SAME_NOISE = 0.02  # of sigma_z


def _names(rows: list[dict[str, Any]]) -> str:
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
    if table['verdict'] != 'partly' or not camera_effects(table):
        return []
    return [
        'The named effects may only imitate a cause that is not in the catalogue: check them in '
        'other scenes with flexx2 gap check.'
    ]


def calibrations(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the forms that were tried; none if nothing was calibrated."""
    rows: list[dict[str, Any]] = (table['calibration'] or {}).get('effects', [])
    return rows


def constants_of(table: dict[str, Any]) -> list[str]:
    """Return the named effects whose form hardly varies with what they are a function of."""
    return [
        row['name'] for row in calibrations(table) if row.get('varies', 1.0) < THRESHOLDS.varies
    ]


def _taken(table: dict[str, Any]) -> list[dict[str, Any]]:
    return [row for row in calibrations(table) if row['taken']]


def headline(table: dict[str, Any]) -> str:
    """Return the verdict in one sentence."""
    gap, rows = table['gap'], table['effects']
    if table['verdict'] == 'none':
        return 'No gap above the tolerance: the recordings look like the simulation.'
    if table['verdict'] == 'too_little':
        return 'Too few depths of the recordings can be compared to say whether there is a gap.'
    if table['verdict'] == 'not_decidable':
        return (
            'No gap above the tolerance, but the ground truth is not accurate enough to decide '
            f'on {_names(table["not_decidable"])}.'
        )
    if table['verdict'] == 'unknown':
        if _hides_cause(table):
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
    if blames_poses(table):
        return f'The poses of the cameras are wrong: correct them first.{rest}'
    likely = max(row['confidence'] for row in rows) >= THRESHOLDS.likely
    simulated = camera_effects(table)
    them = 'it' if len(rows) == 1 else 'them'
    if len(simulated) < len(rows):
        them = listed(simulated)
        fitted = moved(gap['at_fitted_poses']['shrink'], 'what is left')
        rest = f' Once the poses are corrected, it {fitted}.{rest}'
    added = f'The gap {"is" if likely else "may be"} due to {_names(rows)}: adding {them}'
    if gap['shrink'] < 0:
        what = 'makes the misfit'
        if gap['measured_by'] == 'distance':
            what = 'explains other features, but the gap in depth and invalid pixels becomes'
        return f'{added} to the simulation {what} {percent(-gap["shrink"])} larger.{rest}'
    removed = ': '.join(filter(None, [f'{percent(gap["shrink"])} of the gap', _changes(gap)]))
    return f'{added} to the simulation removes {removed}.{rest}'


def significance(table: dict[str, Any]) -> list[str]:
    """Return the p-value of the simulation being the camera, as text; nothing without one."""
    value = table['gap'].get('p_value')
    return [] if value is None else [f'p = {short(value)} for "no gap"']


def _hides_cause(table: dict[str, Any]) -> bool:
    # Whether an effect that the ground truth hides may be the cause of an unknown gap.
    hidden = {row['name'] for row in table['not_decidable']}
    larger = any(reason == 'larger' for reason in refusals(table).values())
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
    for name, unit in (('depth errors', 'wasserstein_mm'), ('invalid pixels', 'invalid_rate')):
        _, symbol, factor = MEASURES[unit]
        before, after, null = (factor * gap[unit][key] for key in ('before', 'after', 'null'))
        if before - null > factor * gap[unit]['tolerance']:
            parts.append(f'{name} {short(before)} -> {short(after)} {symbol}')
    return ', '.join(parts)


def sentences(table: dict[str, Any]) -> list[str]:
    """Return the details below the headline, one line each, those of a first screen first."""
    gap, out = table['gap'], []
    if table['where'] and table['verdict'] != 'none':
        out.append(finding(table['where'][0]))
    if table['verdict'] == 'unknown':
        out = [*_unnamed(table), *out]
    if camera_effects(table):
        out = [*imitation(table), *out, *reduction(gap)[1:]]  # The first is in the table.
        out += [*_noise_level(gap['noise_factor']), *_calibrated(table)]
    if any(row['name'] == of_role('pose').name for row in table['effects']):
        out.append(
            'The gap is measured at the given poses: in other scenes they are as wrong, and no '
            'effect of the simulation corrects them. The list of recordings says how far the '
            'fitted poses are from them.'
        )
    if table['effects']:
        out += [
            f'Alternative explanation: {_names([other])}'
            + (f' instead of {listed(other["instead_of"])}.' if len(table['effects']) > 1 else '.')
            for other in table['alternatives']
        ]
    if table['verdict'] in ('unknown', 'partly') and table['unexplained']:
        names = ', '.join(CHANNELS[row['structure']] for row in table['unexplained'][:4])
        rest = 'The gap' if table['verdict'] == 'unknown' else 'The remaining gap'
        if _taken(table):
            rest = 'Before curves and tables were fitted, the remaining gap'
        out.append(f'{rest} shows in: {names}.')
    if 'patch' in table:
        out += correction(table)
    truths = [row['truth'] for row in table['recordings'] if row['used']]
    truth = accuracy(truths)
    out += [f'Accuracy of the ground truth: {truth}.'] if truth else []
    free = any(one['pose'] is None and not one['planes'] for one in truths)
    if free and len(table['effects']) > 1 and not table['settings']['pose_held']:
        out.append(_POSES_HIDE)
    return out + not_decidable(table) + age_words(table['age'])


def _calibrated(table: dict[str, Any]) -> list[str]:
    # Which effects have another form than that of the catalogue.
    taken, same = _taken(table), [*map(_constant, constants_of(table))]
    if not taken:
        return same
    forms = ', '.join(f'{spaced(row["name"])} ({row["form"]})' for row in taken)
    typical = table['calibration']['typical_gap']
    removed = moved(typical['shrink'], 'the gap', '')
    alike = typical['measured_by'] == table['gap']['measured_by']
    other = f' In the form of the catalogue, the effects would {removed}.' if alike else ''
    return [
        f'Calibrated: {forms}, fitted to these recordings.{other}',
        *map(why_dropped, table['calibration']['dropped']),
        *same,
    ]


def _constant(name: str) -> str:
    return (
        f'{spaced(name)}: its fitted form is about the same everywhere in these recordings. '
        'A cause that does not depend on the same quantity may do this as well.'
    )


def why_dropped(name: str) -> str:
    """Return why a pose error is left out beside a fitted lens."""
    return f'{spaced(name)}: left out; it made up for what the diagnosed lens did not explain.'


def reduction(gap: dict[str, Any]) -> list[str]:
    """Return sentences on the reduction of the gap in physical units, and on what gets worse."""
    out = [difference(gap), _percentage(gap)]
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


def _percentage(gap: dict[str, Any]) -> str:
    # What the reduction in percent counts.
    if gap['measured_by'] == 'loss':
        return (
            'In depth and invalid pixels the gap is below the tolerance. The percentage is '
            'therefore the improvement of the fit: in all that is compared, such as noise and '
            'correlations.'
        )
    return (
        'The percentage counts depth errors in units of the noise, and invalid pixels. 100 % '
        'would be as close as two runs of the simulator.'
    )


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


def not_decidable(table: dict[str, Any]) -> list[str]:
    """Return the undecidable effects, one line for each measurement that would decide."""
    by: dict[str, list[str]] = {}
    for row in table['not_decidable']:
        by.setdefault(row['settled_by'], []).append(row['name'])
    return [
        f'Not decidable with this ground truth: {listed(names)}. This would decide: {what}.'
        for what, names in by.items()
    ]


def accuracy(truths: list[dict[str, Any]]) -> str:
    """Return the accuracy of the ground truth as text; empty if it is taken as exact."""

    def span(key: str, factor: float) -> str:
        values = [factor * one[key] for one in truths if one[key] is not None]
        low, high = short(min(values), 3), short(max(values), 3)
        return low if low == high else f'{low} to {high}'

    parts = []
    if any(one['unknown'] for one in truths):
        parts.append(f'{span("unknown", 100)} % of the pixels unknown')
    if any(one['sigma'] for one in truths):
        parts.append(f'depth known to {span("sigma", 1000)} mm')
    if any(one['pose'] is not None for one in truths):
        parts.append(f'pose to {span("pose", 1000)} mm and {span("turn", 1)} deg')
    if any(one['planes'] for one in truths):
        parts.append(f'planes to {span("offset", 1000)} mm and {span("tilt", 1)} deg')
    return ', '.join(parts)


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
