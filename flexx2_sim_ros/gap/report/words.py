"""A diagnosis in words."""

from typing import Any

from flexx2_sim_ros.effects import of_role

# What people call the channels.
_CHANNELS = {
    'bias': 'depth',
    'invalid': 'share of invalid pixels',
    'high': 'share of outliers behind',
    'low': 'share of outliers in front',
    'log_variance': 'noise (log variance)',
    'kurtosis': "weight of the noise's tails",
    'lag': 'likeness to the frame before',
    'neighbour': 'likeness of neighbouring pixels',
    'trend': 'drift in a recording',
    'frame_common': 'noise common to a frame',
    'row_common': 'noise common to a row',
    'column_common': 'noise common to a column',
    'row_invalid': 'rows lost as a whole',
    'static_grain': 'grain that stays',
    'static_rows': 'stripes that stay, along rows',
    'static_columns': 'stripes that stay, along columns',
    'static_neighbour': 'likeness of neighbours in what stays',
    'frame_spread': 'change of noise from frame to frame',
    'lattice_coarse': 'depths in steps of 6 to 20 mm',
    'lattice_medium': 'depths in steps of 3 to 6 mm',
    'lattice_small': 'depths in steps of 1.5 to 3 mm',
    'lattice_fine': 'depths in steps of 0.6 to 1.5 mm',
    'repeat': 'grain that is the same in all recordings',
}


def _names(rows: list[dict[str, Any]]) -> str:
    return _list([row['name'] for row in rows])


def _list(names: list[str]) -> str:
    names = [name.replace('_', ' ') for name in names]
    return ' and '.join(filter(None, [', '.join(names[:-1]), names[-1]])) if names else ''


def headline(table: dict[str, Any]) -> str:
    """Return the verdict in one sentence."""
    gap, rows = table['gap'], table['effects']
    if table['verdict'] == 'none':
        return 'There is no gap that matters: the recordings look as simulated.'
    if table['verdict'] == 'too_little':
        return 'There was too little to look at to say whether there is a gap.'
    if table['verdict'] == 'unknown':
        return 'There is a gap, and no effect of the catalogue explains it.'
    held = (
        'of the gap on recordings that were not used to find it'
        if gap['held_out']
        else 'of the gap on the one recording it was fitted to'
    )
    if rows[0]['name'] == of_role('pose').name and gap['shrink'] < 0.05:
        return 'The cameras were not where they are believed to be: put that right first.' + (
            ' Something else is left over.' if table['verdict'] == 'partly' else ''
        )
    rest = ' Something else is left over.' if table['verdict'] == 'partly' else ''
    return (
        f'The gap is due to {_names(rows)}: adding {"it" if len(rows) == 1 else "them"} '
        f'takes away {gap["shrink"]:.0%} {held}.{rest}'
    )


def sentences(table: dict[str, Any]) -> list[str]:
    """Return what else a person should know, a line each."""
    out = []
    gap = table['gap']
    if table['effects'] and gap['interval'] is not None:
        out.append(
            f'90 % interval of that share: {gap["interval"][0]:.0%} to {gap["interval"][1]:.0%}.'
        )
    if any(row['name'] == of_role('pose').name for row in table['effects']):
        out.append(
            "The gap is what is left with each recording's camera where it was found to "
            'be; the recordings list how far that is from where it was believed to be.'
        )
    if 'note' in gap:
        out.append(gap['note'][0].upper() + gap['note'][1:] + '.')
    if table['effects']:
        out += [
            f'Could as well be {_names([other])}'
            + (f' instead of {_list(other["instead_of"])}.' if len(table['effects']) > 1 else '.')
            for other in table['alternatives']
        ]
    if table['verdict'] in ('unknown', 'partly') and table['unexplained']:
        names = ', '.join(_CHANNELS[row['structure']] for row in table['unexplained'][:4])
        out.append(f'What is left shows in: {names}.')
    if 'patch' in table:
        out.append(
            f'effects.yaml holds a patch without a cause instead, over '
            f'{table["patch"]["covariate"].replace("_", " ")}: it takes '
            f'{table["patch"]["shrink"]:.0%} of the gap in bias, noise and loss off.'
        )
    if table['where'] and table['verdict'] != 'none':
        out.append(f'It is largest here: {place(table["where"][0])}.')
    return out


def remarks(table: dict[str, Any]) -> list[str]:
    """Return what is wrong with recordings and what was not considered, a line each."""
    rows = table['recordings']
    return (
        not_considered(table)
        + [f'Left out: {row["reason"]}.' for row in rows if not row['used']]
        + [f'Note: {note}.' for row in rows if row['used'] for note in row['notes']]
    )


def not_considered(table: dict[str, Any]) -> list[str]:
    """Return which effects were not considered, a line for each reason."""
    reasons: dict[str, list[str]] = {}
    for row in table['not_considered']:
        reasons.setdefault(row['reason'], []).append(row['name'])
    return [f'Not considered: {_list(names)}: {reason}.' for reason, names in reasons.items()]


def place(cell: dict[str, Any]) -> str:
    """Return where a cell is and what differs there."""
    low, high, unit = cell['low'], cell['high'], cell['unit']
    where = cell['covariate'].replace('_', ' ')
    if where == 'structure':
        where = 'all over'
    if where == 'all':
        where = 'on all surfaces'
    if where == 'edge' and not cell['detail']:
        where = 'at edges'
    elif cell['detail']:
        where += f' ({cell["detail"]})'
    elif low is not None and high is not None:
        where += f' {low:.3g} to {high:.3g} {unit}'
    elif low is not None:
        where += f' above {low:.3g} {unit}'
    elif high is not None:
        where += f' below {high:.3g} {unit}'
    what = _CHANNELS[cell['channel']]
    size = (
        f'{cell["size"]:+.2f} mm'
        if cell['unit_size'] == 'mm'
        else f'{cell["size"]:+.1%}'
        if what.startswith('share')
        else f'{cell["size"]:+.2g}'
    )
    return f'{where.strip()}: {what} {size}'
