"""The page of what a gap costs, and its sentences and tables for the terminal and the report."""

from collections.abc import Iterator, Sequence
from typing import Any

from flexx2_sim_ros import html_parts as html
from flexx2_sim_ros.consumers.comparison import FEWEST
from flexx2_sim_ros.consumers.running import Result
from flexx2_sim_ros.gap.report.frames import quantile
from flexx2_sim_ros.gap.report.text import listed, percent, short, spaced
from flexx2_sim_ros.html_drawing import bar, picture
from flexx2_sim_ros.html_page import html_page
import numpy as np

RANKING = 'effect', 'of what all effects change', 'takes away', 'measures'
HEADS = 'recorded', 'as simulated', 'with all effects', 'taken away first'
_STYLE = """
td + td { white-space: nowrap; }
.row img { image-rendering: pixelated; height: 11rem; width: auto; }
"""
_PICTURES = {'real': 'recorded', 'simulated': 'as simulated', 'all effects': 'with all effects'}
_SECTION = (
    'Errors of what reads depth on a robot, against the true depth: on the recordings, and on '
    'their simulation. Only those that differ more than two simulations do. The last column is '
    'how much of the difference the best effect alone takes away, with a 90 % interval. '
    'docs/robots.md says more.'
)
NOTHING_SEEN = 'No recording shows what it measures.'
_LEAST_COLOUR = 0.02  # metres: smaller errors are drawn pale


def headline(table: dict[str, Any]) -> str:
    """Return the result in one sentence."""
    if not table['consumers']:
        return 'No consumer could be used.'
    if sum(row['used'] for row in table['recordings']) < FEWEST:
        return f'The cost is not judged: this needs at least {FEWEST} recordings.'
    if not table['ranking']:
        return 'No cost that stands out: no measure differs more than two simulations do.'
    best = table['ranking'][0]
    tied = _tied(table, 0)
    undecided = f' {_undecided([best["effect"], *tied])}' if tied else ''
    if best['share'] <= 0:
        return (
            f'Of the effects, {spaced(best["effect"])} changes most on average, but as it was '
            f'fitted it does not take the cost of the gap away.{undecided}'
        )
    consumer, measure = _clearest(table, best['effect'])
    one = measure['effects'][best['effect']]
    where = f'{spaced(measure["name"])} ({spaced(consumer)})'
    apart = f'{short(measure["difference"], 3)} {measure["unit"]}'.strip()
    first = '' if tied else ' first'
    return (
        f'Modelling {spaced(best["effect"])}{first} takes away {_percent(one)} of the difference '
        f'in {where}. A recording and its simulation differ by {apart} in this, on average.'
        f'{undecided}'
    )


def _tied(table: dict[str, Any], place: int) -> list[str]:
    # Effects behind a place of the ranking that may as well be ahead of it.
    own, *later = table['ranking'][place:]
    return [row['effect'] for row in later if row['effect'] not in own['ahead_of']]


def _undecided(names: Sequence[str]) -> str:
    return f'These recordings cannot order {listed(names)}.'


def _clearest(table: dict[str, Any], effect: str) -> tuple[str, dict[str, Any]]:
    # The measure of which the effect takes away most for sure.
    def sure(row: tuple[str, dict[str, Any]]) -> float:
        one = row[1]['effects'][effect]
        return float((one['interval'] or [one['share']])[0])

    every = ((one['name'], measure) for one in table['consumers'] for measure in one['measures'])
    return max((row for row in every if row[1]['significant']), key=sure)


def ranking(table: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a row for each effect below `RANKING`, if there is a ranking: means over measures."""
    return [
        (spaced(row['effect']), _percent(row, 'part'), percent(row['share']), str(row['measures']))
        for row in table['ranking']
    ]


def sentences(table: dict[str, Any]) -> list[str]:
    """Return what else a person should know, one line each."""
    used = [row for row in table['recordings'] if row['used']]
    fitted = sum(row['effects_from'] == 'this recording' for row in used)
    out = []
    for place, row in enumerate(table['ranking'][1:], start=1):  # the first: in the headline
        tied = _tied(table, place)
        out += [_undecided([row['effect'], *tied])] if tied else []
    delay = table['settings']['delay']
    if delay:
        out.append(
            f'The delay of the images, {1e3 * delay:.0f} ms, is not in the cost: each image is '
            'compared with the scene at its stamp.'
        )
    if fitted:
        out.append(
            f'The effects were fitted to {fitted} of these {len(used)} recordings as well, so the '
            'fractions can be too large.'
        )
    out += [f'Given up: {row["consumer"]}: {row["reason"]}.' for row in table['faults']]
    out += [f'Not read: installed package {name}.' for name in table['damaged_packages']]
    return out + [f'Left out: {row["reason"]}.' for row in table['recordings'] if not row['used']]


def lines(consumer: dict[str, Any]) -> Iterator[tuple[tuple[str, ...], bool]]:
    """Yield each measure of a consumer as text, its values below `HEADS`, and if it is clear."""
    for one in consumer['measures']:
        unit = f', {one["unit"]}' if one['unit'] else ''
        name, best = max(one['effects'].items(), key=lambda item: item[1]['share'])
        first = 'no difference' if one['recordings'] >= FEWEST else 'too few recordings'
        if one['significant']:
            first = f'{spaced(name)} {_percent(best)}' if best['share'] > 0 else 'no effect alone'
        sizes = one['real'], one['simulated'], one['all_effects']['value']
        cells = f'{spaced(one["name"])}{unit}', *(short(size, 3) for size in sizes), first
        yield cells, one['significant']


def _percent(one: dict[str, Any], key: str = 'share') -> str:
    # Adding 0 makes -0 to 0.
    share, *ends = (percent(round(x, 2) + 0.0) for x in (one[key], *(one['interval'] or ())))
    return f'{share} ({" to ".join(ends)})' if ends else share


def in_short(table: dict[str, Any]) -> str:
    """Return the cost that a diagnosis has measured, or why it has none, in one sentence."""
    return f'No cost: {table["reason"]}.' if 'reason' in table else headline(table)


def section(table: dict[str, Any]) -> html.Html:
    """
    Return the cost as a section of the report of a diagnosis.

    `table` is what `cost.measure_cost` returns, or a ``reason`` why there is none.
    """
    title = 'What the gap costs a robot'
    if 'reason' in table:
        return html.folded(title, html.element('p', in_short(table)))
    rows: list[html.Html | tuple[str, ...]] = []
    for consumer in table['consumers']:
        texts = [line for line, significant in lines(consumer) if significant]
        name = html.element('th', spaced(consumer['name']), colspan='5')
        rows += [html.element('tr', name), *texts] if texts else []
    shown = [html.table(['mean error of', *HEADS], rows), html.note(_SECTION)] if rows else []
    first = html.element('p', html.element('b', in_short(table)))
    return html.folded(title, first, *_below(table), *shown)


def _below(table: dict[str, Any]) -> list[html.Html]:
    # What is below the headline.
    rows = ranking(table)
    return [html.table(RANKING, rows) if rows else html.Html(), html.paragraphs(sentences(table))]


def page(table: dict[str, Any], results: Sequence[Result]) -> str:
    """Return the page as HTML, all text escaped and all pictures inside."""
    used = [row for row in table['recordings'] if row['used']]
    good = [one for one in results if not one.fault]  # those of the table, in its order
    body = [
        html.note(f'What the gap costs, on {len(used)} recordings'),
        html.heading(headline(table), 1),
        *_below(table),
        *(_consumer(*both) for both in zip(table['consumers'], good, strict=True)),
        html.note(
            'The recordings and their simulations go through the same program. Values are means '
            'over recordings of its errors against the true depth. The difference is the mean '
            'absolute difference between a recording and its simulation; "two simulations" is '
            'that of two runs of the simulator, which a perfect simulation would still show. '
            'Fractions of the difference are those that one effect alone takes away, with 90 % '
            'intervals (bootstrap over recordings). Bars: gray without effects, blue with the '
            'effect; the mark is the difference of two simulations.'
        ),
        html.made_by(table, 'docs/robots.md'),
    ]
    return html_page('What the gap costs', _STYLE, '\n'.join(body))


def _consumer(one: dict[str, Any], result: Result) -> html.Html:
    title = html.join(html.heading(spaced(one['name'])), html.element('p', one['title']))
    if not one['measures']:
        return html.join(title, html.element('p', NOTHING_SEEN, kind='dim'))
    rows = []
    for measure in one['measures']:
        unit = f', {measure["unit"]}' if measure['unit'] else ''
        cells = [
            f'{spaced(measure["name"])}{unit}',
            *(short(measure[key], 3) for key in ('real', 'simulated', 'difference', 'null')),
        ]
        rows.append(html.row([*cells, '', ''], '' if measure['significant'] else 'dim'))
        if measure['significant']:
            effects = {**measure['effects'], 'all effects': measure['all_effects']}
            for name, left in effects.items():
                values = ['', '', short(left['value'], 3), short(left['difference'], 3), '']
                drawn = bar(measure['difference'], left['difference'], measure['null'])
                rows.append(html.row([*values, f'{spaced(name)}: {_percent(left)}', drawn]))
    heads = ('', 'recorded', 'simulated', 'difference', 'two simulations', 'taken away by', '')
    return html.join(title, html.table(heads, rows), _pictures(result))


def _pictures(result: Result) -> html.Html:
    # Of the recording whose simulation differs most from it.
    def apart(one: dict[str, np.ndarray]) -> float:
        return float(np.nan_to_num(np.abs(one['real'] - one['simulated'])).sum())

    some = [one for one in result.pictures if one.keys() >= _PICTURES.keys()]
    if not some:
        return html.Html()
    images = max(some, key=apart)
    shown = np.concatenate([images[name].ravel() for name in _PICTURES])
    limit = max(quantile(np.abs(shown), 0.98), _LEAST_COLOUR)
    # x ahead is up in the picture, y left is left.
    figures = (
        html.figure(picture(np.flip(images[name]), limit), text)
        for name, text in _PICTURES.items()
    )
    return html.join(
        html.beside(*figures),
        html.note(
            'Error of each height, red too high, blue too low, full colour at '
            f'{1000 * limit:.0f} mm, gray without data; ahead is up. The recording whose '
            'simulation differs most.'
        ),
    )
