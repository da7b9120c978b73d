"""What all reports in HTML share: the frame of a page and its basic style."""

from html import escape
from string import Template

_PAGE = Template(
    """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title><style>
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: #1c2733;
  background: #fff; max-width: 66rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin-bottom: .2rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; border-bottom: 1px solid #d8dfe6; }
p { margin: .4rem 0; }
table { border-collapse: collapse; margin: .6rem 0; font-size: .9rem; }
td { font-variant-numeric: tabular-nums; }
th { font-weight: 600; }
img { max-width: 100%; height: auto; }
svg { max-width: 100%; }
code { font-size: .92em; }
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
        CSS of this page, after the style that all pages have.
    body : str
        HTML.

    Returns
    -------
    str
        HTML.

    """
    return _PAGE.substitute(title=escape(title), style=style, body=body)
