"""The common parts of all HTML reports: page, colours and basic style."""

from html import escape
from string import Template

_PAGE = Template(
    """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title><style>
:root { color-scheme: light dark; --ink: #1c2733; --page: #fff; --dim: #5a6b7b; --line: #d8dfe6;
  --faint: #eef1f4; --blue: #1f6feb; --orange: #d9480f; --gray: #b8c4cf; --green: #1b6e2d;
  --red: #a40000; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e9ee; --page: #14181d; --dim: #9aa8b5;
  --line: #36404a; --faint: #232a31; --blue: #58a6ff; --orange: #ff8a4c; --gray: #66727e;
  --green: #63c97b; --red: #ff7b72; } }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: var(--ink);
  background: var(--page); max-width: 66rem; margin: 2rem auto; padding: 0 1.2rem;
  overflow-wrap: break-word; }
h1 { font-size: 1.6rem; line-height: 1.25; margin-bottom: .2rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; border-bottom: 1px solid var(--line); }
p { margin: .4rem 0; }
table { border-collapse: collapse; margin: .6rem 0; font-size: .9rem; }
td { font-variant-numeric: tabular-nums; }
th { font-weight: 600; }
.scroll { overflow-x: auto; }
figure { margin: 0; }
img { max-width: 100%; height: auto; background: #fff; }
svg { max-width: 100%; height: auto; }
code { font-size: .92em; background: var(--faint); padding: 0 .25rem; }
$style</style></head><body>
$body
</body></html>
"""
)


def html_page(title: str, style: str, body: str) -> str:
    """
    Return a page that needs no other file.

    Parameters
    ----------
    title : str
        Plain text; escaped here.
    style : str
        CSS of this page, added to the common style.
    body : str
        HTML.

    Returns
    -------
    str
        HTML.

    """
    return _PAGE.substitute(title=escape(title), style=style, body=body)
