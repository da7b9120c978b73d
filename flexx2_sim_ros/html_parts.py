"""What HTML pages are made of: text, tables, figures and folds."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any


class Html(str):
    """HTML that goes into a page as it is; any other text is escaped."""

    __slots__ = ()


def join(*parts: str) -> Html:
    """Return parts one after the other."""
    return Html(''.join(one if isinstance(one, Html) else escape(one) for one in parts))


def element(name: str, *parts: str, kind: str = '', **attributes: str) -> Html:
    """
    Return an element, such as ``td``, with parts inside.

    ``kind`` are its classes in the style, ``attributes`` others.
    """
    told = {'class': kind, **attributes} if kind else attributes
    words = ''.join(f' {key}="{escape(value)}"' for key, value in told.items())
    end = '' if name in ('br', 'img', 'input') else f'</{name}>'
    return Html(f'<{name}{words}>{join(*parts)}{end}')


def heading(text: str, level: int = 2) -> Html:
    """Return a heading."""
    return element(f'h{level}', text)


def paragraphs(lines: Iterable[str]) -> Html:
    """Return each line as a paragraph."""
    return join(*(element('p', line) for line in lines))


def note(*parts: str) -> Html:
    """Return a paragraph in small letters."""
    return element('p', element('small', *parts))


def bullets(lines: Iterable[str]) -> Html:
    """Return a list."""
    return element('ul', *(element('li', line) for line in lines))


def row(cells: Iterable[str], kind: str = '') -> Html:
    """Return a row of a table, for rows that are not like the others."""
    return element('tr', *(element('td', cell) for cell in cells), kind=kind)


def table(heads: Sequence[str], rows: Iterable[Sequence[str] | Html], kind: str = '') -> Html:
    """
    Return a table that scrolls where it is too wide; ``kind`` is its class in the style.

    ``heads`` are above the columns; empty for none. Rows are the cells of each, or made by `row`.
    """
    lines = [one if isinstance(one, Html) else row(one) for one in rows]
    if heads:
        lines.insert(0, element('tr', *(element('th', one) for one in heads)))
    return element('div', element('table', *lines, kind=kind), kind='scroll')


def folded(summary: str, *parts: str) -> Html:
    """Return what a click on a line shows."""
    return element('details', element('summary', summary), *parts)


def definitions(summary: str, meanings: Mapping[str, str]) -> Html:
    """Return a folded list of names and what they mean."""
    return folded(
        summary, bullets(join(element('b', name), f': {text}') for name, text in meanings.items())
    )


def figure(url: str, caption: str, alt: str = '', width: int | None = None) -> Html:
    """
    Return a picture, a data URL, with a caption below it.

    ``alt`` is for those who cannot see it; empty: the caption. ``width`` is in pixels; default: as
    large as the style says.
    """
    size = {} if width is None else {'width': str(width)}
    drawn = element('img', alt=alt or caption, **size, src=url)
    return element('figure', drawn, element('figcaption', caption))


def beside(*figures: str) -> Html:
    """Return figures beside each other, where there is space."""
    return element('div', *figures, kind='row')


def tag(word: str, kind: str = '') -> Html:
    """Return a verdict: ``good``, ``named``, ``doubtful`` or ``bad``."""
    return element('span', word, kind=f'tag {kind}'.strip())


def key(colour: str, text: str) -> Html:
    """Return the name of what bars show in a colour: ``gray``, ``blue`` or a ``line``."""
    return join(element('span', kind=f'key {colour}'), text)


def code(text: str) -> Html:
    """Return text whose parts between backquotes are code."""
    parts = text.split('`')
    return join(*(element('code', one) if i % 2 else one for i, one in enumerate(parts)))


def shell(lines: Iterable[str]) -> Html:
    """Return lines to type."""
    return element('pre', element('code', '\n'.join(lines)))


def made_by(table: Mapping[str, Any], docs: str) -> Html:
    """Return with what a page was made, and where it is explained."""
    memory = f' with {table["peak_mb"]:.0f} MB' if 'peak_mb' in table else ''
    return element(
        'p',
        f'Made by flexx2_sim_ros {table["version"]} in {table["seconds"]:.0f} s{memory}. {docs} '
        'says how each number is computed.',
        kind='dim',
    )
