"""What is written from the registry: preset files and the documentation's table."""

from textwrap import fill

from flexx2_sim_ros.effects.effect import Effect, Parameter
from flexx2_sim_ros.effects.registry import effects_yaml, registry
from flexx2_sim_ros.effects.tables import Table

_WIDTH = 95


def preset_files() -> dict[str, str]:
    """
    Return the presets of ``config/effects`` by file name.

    There is one for each effect at its typical strength, and ``typical.yaml`` with all that a
    typical camera, well placed and calibrated, shows.
    """
    files = {
        f'{name}.yaml': effects_yaml([kind()], _comment(kind)) for name, kind in registry().items()
    }
    files['typical.yaml'] = effects_yaml(
        [kind() for kind in registry().values() if kind.typical],
        'What a typical camera shows that is well placed and calibrated. Left out: errors of '
        'placement and\ncalibration, and what the noise model has in it already, since it was '
        'measured on what the\ncamera sends. Written by `flexx2 effects --write-presets`.',
    )
    return files


def _comment(kind: type[Effect]) -> str:
    title = fill(f'{kind.title[0].upper()}{kind.title[1:]}.', _WIDTH)
    return f'{title}\n{fill(f"Source: {kind.source}.", _WIDTH)}'


def _nature(kind: type[Effect]) -> str:
    words = [f'Form: {kind.family}.'] if kind.family else []
    if kind.nuisances:
        errors = [_NUISANCES[name] for name in kind.nuisances]
        words.append(f'Looks like: {", ".join(errors)}.')
    if kind.batched is None:
        words.append('In a batch: on the CPU, one environment after the other.')
    return ' '.join(words)


_NUISANCES = {
    'pose': 'the pose',
    'reflectivity': 'reflectivity',
    'sigma': "the base model's sigma",
    'edges': 'where edges are',
    'uptime': 'the time since power-on',
}


def _typical(item: Parameter) -> str:
    unit = f' {item.unit}' if item.unit else ''
    return f'* `{item.name}` = {item.default:g}{unit} ({bounds(item)}): {item.text}'


def _form(name: str, table: Table) -> str:
    unit = f' {table.unit}' if table.unit else ''
    over = {'curve': f' over {table.over}', 'map': ' of the image, (H, W)'}.get(table.kind, '')
    return f'* `{name}` ({table.kind}{over}, {table.low:g} to {table.high:g}{unit}): {table.text}'


def bounds(item: Parameter) -> str:
    """Return a parameter's range for people."""
    return f'{item.low:g} to {item.high:g}'


def markdown() -> str:
    """Return ``docs/effects.md``."""
    effects = registry().values()
    lines = [
        '# Effects',
        '',
        '<!-- Written by `flexx2 effects --markdown`. -->',
        '',
        *fill(
            f'{len(effects)} effects of a real time-of-flight camera that the noise model '
            'leaves out, in the order in which they act on the light. `flexx2 effects show NAME` '
            'draws what one does, and `--effects NAME` of `flexx2 simulate` adds it. Each has a '
            'strength from 0 (off) to 4; 1 is typical. *Shows in* says what it changes in a '
            'static scene. '
            '● is in `config/effects/typical.yaml`; ↻ depends on earlier frames; ∿ needs '
            'the modulation frequencies. *Looks like* names errors that can hide it. '
            '`parameter` = typical value (range). Values without a public source are marked as '
            'assumed.',
            _WIDTH,
        ).splitlines(),
        '',
        *fill(
            'A file of effects may give some effects a curve or a map in the place of their '
            'formula: `curve: {knots: [...], values: [...]}`, linear between the knots and '
            'constant beyond them, repeated with `period` if that is given; `pattern: '
            'NAME.npz`, a file beside it with one (H, W) array `map`. `strength` multiplies '
            'shifts. A probability p to be invalid becomes 1 - (1 - p)^strength, a factor f on '
            'sigma_z 1 + strength (f - 1).',
            _WIDTH,
        ).splitlines(),
        '',
        '| effect | | what it is | stage | shows in | source |',
        '|---|---|---|---|---|---|',
    ]
    lines += [
        f'| [`{kind.name}`](#{kind.name}) | {"●" if kind.typical else ""}'
        f'{"↻" if kind.keeps else ""}{"∿" if kind.needs_modulation else ""} | '
        f'{kind.title} | {kind.stage.name.lower()} | '
        f'{", ".join(kind.changes) or "moving scenes"} | {kind.source} |'
        for kind in effects
    ]
    lines += ['', '## Parameters', '']
    for kind in effects:
        rows = [_typical(item) for item in kind.parameters() if item.name != 'strength']
        rows += [_form(name, table) for name, table in kind.tables().items()]
        items = [fill(row, _WIDTH, subsequent_indent='  ') for row in rows]
        lines += [f'### {kind.name}', '', fill(_nature(kind), _WIDTH), '', *items, '']
    return '\n'.join(lines[:-1]) + '\n'
