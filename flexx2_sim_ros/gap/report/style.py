"""CSS and HTML that the pages of a diagnosis and of a check share."""

from collections.abc import Mapping
from html import escape

STYLE = """
td, th { padding: .18rem .9rem .18rem 0; text-align: left; vertical-align: top; }
th, small, .dim, figcaption { color: var(--dim); }
.tag { display: inline-block; padding: .1rem .6rem; border-radius: 1rem; color: #fff;
  font-weight: 600; background: #5a6b7b; }
.bar { width: 10rem; height: 1rem; max-width: none; display: block; }
summary { cursor: pointer; margin: .8rem 0; } ul { font-size: .85rem; }
.key { display: inline-block; width: .7rem; height: .7rem; margin-right: .35rem; }
.gray { background: var(--gray); } .blue { background: var(--blue); }
.line { background: var(--ink); width: .14rem; height: .9rem; vertical-align: -.1rem; }
.before { fill: var(--gray); } .after { fill: var(--blue); } .null { fill: var(--ink); }
"""


def definitions(meanings: Mapping[str, str]) -> str:
    """Return a folded list of what the rows of a table mean, as HTML; keys are their names."""
    rows = ''.join(
        f'<li><b>{escape(name)}</b>: {escape(meaning)}</li>' for name, meaning in meanings.items()
    )
    return f'<details><summary>What the rows mean</summary><ul class="dim">{rows}</ul></details>'
