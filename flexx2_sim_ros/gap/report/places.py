"""Where a gap lies, as text: rows of `where` of a diagnosis."""

import math
import re
from typing import Any

from flexx2_sim_ros.gap.report.text import short, spaced

# Names of the channels, for people.
CHANNELS = {
    'bias': 'depth',
    'invalid': 'fraction of invalid pixels',
    'high': 'fraction of outliers behind',
    'low': 'fraction of outliers in front',
    'log_variance': 'noise',
    'kurtosis': 'tails of the noise (kurtosis)',
    'lag': 'correlation with the frame before',
    'neighbour': 'correlation of neighbouring pixels',
    'trend': 'drift over a recording',
    'frame_common': 'noise common to a frame',
    'row_common': 'noise common to a row',
    'column_common': 'noise common to a column',
    'row_invalid': 'rows without any depth',
    'static_grain': 'fixed-pattern noise',
    'static_rows': 'fixed-pattern noise along rows',
    'static_columns': 'fixed-pattern noise along columns',
    'static_neighbour': 'correlation of neighbours in the fixed-pattern noise',
    'jump_between': 'fraction of depths between the surfaces at jumps',
    'jump_switches': 'fraction of depths at jumps that switch to the other surface',
    'frame_spread': 'change of noise from frame to frame',
    'lattice_coarse': 'depth in steps of 6 to 20 mm',
    'lattice_medium': 'depth in steps of 3 to 6 mm',
    'lattice_small': 'depth in steps of 1.5 to 3 mm',
    'lattice_fine': 'depth in steps of 0.6 to 1.5 mm',
    'repeat': 'fixed-pattern noise that is the same in all recordings',
}
# What to record to see a difference along each covariate alone.
_NEXT_STEPS = {
    **dict.fromkeys(('all', 'structure'), 'A flat wall, seen straight on, is enough to see it.'),
    'distance': 'To see it alone, move the camera towards a flat wall in small steps.',
    'incidence': 'To see it alone, turn a flat board away from the camera in small steps.',
    'amplitude': 'To see it alone, record a dark and a bright board at the same distance.',
    'edge': 'To see it alone, record the edge of a box in front of a wall.',
    'speed': 'To see it alone, move the camera towards a wall, then hold it still.',
    'uptime': 'To see it alone, record a still scene from power-on for half an hour.',
    **dict.fromkeys(
        ('radius', 'region'),
        'To see it alone, record a flat wall that fills the image; check the camera matrix.',
    ),
    'recording': 'Look for what was different in this recording: lighting, poses, settings.',
}
# Units of a difference that is written as it is in the table.
_UNITS = {
    'fraction of variance': ' of the variance',
    'sigma^2': ' sigma_z^2',
    'ln': ' (ln)',
    'log10': ' (log10 of its power)',
}
_WALL = 0.2  # reflectivity of the wall that an amplitude is compared with
# Channels whose difference in a group of pixels makes a sentence, with words for more and less.
_MORE_OR_LESS = {
    'kurtosis': 'have <heavier/lighter> tails of the noise',
    'lag': 'follow the frame before <more/less> closely: the correlation is {} <higher/lower>',
    'neighbour': 'have noise that is <more/less> alike in neighbouring pixels: the correlation is '
    '{} <higher/lower>',
    'trend': 'drift {} mm <away/nearer> during a recording',
    'bias': 'read {} mm too <far/near>',
    'invalid': 'have no depth in {} % <more/fewer> of their pixels',
    'high': 'read far too far in {} % <more/fewer> of their pixels',
    'low': 'read far too near in {} % <more/fewer> of their pixels',
}


def finding(cell: dict[str, Any]) -> str:
    """Return a row of ``where`` as sentences: what differs from the simulation, what to do now."""
    covariate = cell['covariate'].removeprefix('fine_')
    step = _NEXT_STEPS.get('region' if covariate.startswith('image') else covariate, '')
    first = 'alike' if covariate == 'structure' else 'largest here:'
    said = None if covariate == 'structure' else _said(cell)
    what = f': {difference(cell)}' if said is None else f' {said}'
    return f'The gap is {first} {group(cell)}{what}. {step}'.strip()


def _said(cell: dict[str, Any]) -> str | None:
    # What a group of pixels does, as the rest of a sentence; None where only its name says it.
    channel, size = cell['channel'], float(cell['size'])
    if channel == 'log_variance':
        return f'have {short(math.exp(size / 2), 3)} times the noise of the simulation'
    if channel not in _MORE_OR_LESS:
        return None
    percent = CHANNELS[channel].startswith('fraction')
    said = re.sub('<(.*?)/(.*?)>', r'\2' if size < 0 else r'\1', _MORE_OR_LESS[channel])
    return said.format(short(abs(size) * (100 if percent else 1)))


def group(cell: dict[str, Any]) -> str:
    """Return the pixels of a row of `where` as text, in plural."""
    name, low, high = cell['covariate'].removeprefix('fine_'), cell['low'], cell['high']
    span = _span(low, high, cell['unit'])
    if name == 'speed':
        return f'surfaces {_direction(low, high)} ({span})'
    words = {
        'structure': 'everywhere',
        'all': 'all surfaces',
        'edge': 'pixels at depth jumps' + (f' ({cell["detail"]})' if cell['detail'] else ''),
        'recording': f'surfaces in recording {cell["detail"]}',
        'uptime': f'surfaces at a time since power-on {span}',
        'distance': f'surfaces at a distance {span}',
        'incidence': f'surfaces seen at an angle {span}',
        'amplitude': f'surfaces {_as_bright(low, high)}',
        'radius': f'pixels at a distance from the image centre {span} of the half-diagonal',
        'nothing there': 'pixels without a return',
        'beyond the range': 'surfaces beyond the range',
    }
    if name in words:
        return words[name]
    detail = f'({cell["detail"]})' if cell['detail'] else span
    return f'pixels in {spaced(name)} {detail}'.strip()


def _direction(low: float | None, high: float | None) -> str:
    # Which way surfaces with these speeds along the optical axis move.
    if high is not None and high <= 0:
        return 'that come nearer'
    if low is not None and low >= 0:
        return 'that move away'
    return 'at a speed'


def _as_bright(low: float | None, high: float | None) -> str:
    # An amplitude, 1/m^2, as where a wall that is seen straight on has it.
    wall = f'a wall of reflectivity {_WALL:g} at'
    near, far = (end and short(math.sqrt(_WALL / end), 3) for end in (high, low))
    if far is None:
        return f'darker than {wall} {near} m'
    if near is None:
        return f'brighter than {wall} {far} m'
    return f'as bright as {wall} {near} to {far} m'


def _span(low: float | None, high: float | None, unit: str) -> str:
    words = {(True, True): 'from {} to {}', (True, False): 'above {}', (False, True): 'below {1}'}
    ends = ['' if end is None else short(end, 3) for end in (low, high)]
    text = words.get((low is not None, high is not None), '').format(*ends)
    return f'{text} {unit}'.strip() if text else ''


def difference(cell: dict[str, Any]) -> str:
    """Return what differs in a row of `where`, real minus simulated, as text."""
    what, size, unit = CHANNELS[cell['channel']], cell['size'], cell['unit_size']
    if cell['channel'] == 'log_variance':
        return f'noise {short(math.exp(size / 2), 3)} times as large'
    exact = {'mm': f'{size:+.2f} mm', 'fraction': f'{100 * size:+.1f} %'}
    usual = ('+' if size >= 0 else '') + short(size) + _UNITS.get(unit, '')
    return f'{what} {exact.get(unit, usual)}'
