"""A diagnosis in words."""

from typing import Any


def _names(rows: list[dict[str, Any]]) -> str:
    names = [row['name'].replace('_', ' ') for row in rows]
    return ' and '.join(filter(None, [', '.join(names[:-1]), names[-1]])) if names else ''


def headline(table: dict[str, Any]) -> str:
    """Return the verdict in one sentence."""
    gap, rows = table['gap'], table['effects']
    if table['verdict'] == 'none':
        return 'There is no gap that matters: the recordings look as simulated.'
    if table['verdict'] == 'unknown':
        return 'There is a gap, and no effect of the catalogue explains it.'
    held = ('of the gap on recordings that were not used to find it' if gap['held_out']
            else 'of the gap on the one recording it was fitted to')
    rest = ' Something else is left over.' if table['verdict'] == 'partly' else ''
    return (f'The gap is due to {_names(rows)}: adding {"it" if len(rows) == 1 else "them"} '
            f'takes away {gap["shrink"]:.0%} {held}.{rest}')


def sentences(table: dict[str, Any]) -> list[str]:
    """Return what else a person should know, a line each."""
    out = []
    gap = table['gap']
    if table['effects'] and gap['interval'] is not None:
        out.append(f'90 % interval of that share: {gap["interval"][0]:.0%} to '
                   f'{gap["interval"][1]:.0%}.')
    if 'note' in gap:
        out.append(gap['note'][0].upper() + gap['note'][1:] + '.')
    if table['effects']:
        out += [f'Could not be told apart from {_names(other["effects"])}.'
                for other in table['alternatives']]
    if table['verdict'] in ('unknown', 'partly') and table['unexplained']:
        names = ', '.join(row['structure'].replace('_', ' ') for row in table['unexplained'][:4])
        out.append(f'What is left shows in: {names}.')
    if table['where']:
        out.append(f'It is largest here: {place(table["where"][0])}.')
    return out + [f'Left out: {row["reason"]}.' for row in table['recordings']
                  if not row['used']]


def place(cell: dict[str, Any]) -> str:
    """Return where a cell is and what differs there."""
    low, high, unit = cell['low'], cell['high'], cell['unit']
    where = cell['covariate'].replace('_', ' ')
    if low is not None and high is not None:
        where += f' {low:g} to {high:g} {unit}'
    elif low is not None:
        where += f' above {low:g} {unit}'
    elif high is not None:
        where += f' below {high:g} {unit}'
    what = cell['channel'].replace('_', ' ')
    size = f'{cell["size"]:+.2f} mm' if cell['unit_size'] == 'mm' else f'{cell["size"]:+.3g}'
    return f'{where.strip()}: {what} {size}'
