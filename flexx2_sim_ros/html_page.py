"""A page that needs no other file, and the style of all pages; `html_parts` is what they show."""

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
h3 { font-size: 1rem; margin: 1rem 0 .3rem; }
p { margin: .4rem 0; }
table { border-collapse: collapse; margin: .6rem 0; font-size: .9rem; }
td, th { padding: .18rem .9rem .18rem 0; text-align: left; vertical-align: top; }
td { font-variant-numeric: tabular-nums; }
th { font-weight: 600; }
th, small, .dim, figcaption { color: var(--dim); }
.dim td { color: var(--dim); }
.scroll { overflow-x: auto; }
.good { color: var(--green); } .bad { color: var(--red); }
.tag { display: inline-block; padding: .1rem .6rem; border-radius: 1rem; font-weight: 600;
  background: #5a6b7b; }
span.tag { color: #fff; }
.tag.good { background: #2e7d4f; } .tag.named { background: #1f6feb; }
.tag.doubtful { background: #b7791f; } .tag.bad { background: #a8324a; }
summary { cursor: pointer; margin: .8rem 0; }
details ul { font-size: .85rem; }
figure { margin: 0; }
figcaption { font-size: .85rem; }
.row { display: flex; flex-wrap: wrap; gap: 1.2rem; }
.row figure { max-width: 27.5rem; }
img { max-width: 100%; height: auto; background: #fff; }
svg { max-width: 100%; height: auto; }
svg text { fill: var(--ink); }
.curve { fill: none; stroke-width: 2; } .grid { stroke: var(--line); }
.real { stroke: var(--ink); } .simulated { stroke: var(--orange); stroke-dasharray: 5 3; }
.effects { stroke: var(--blue); } .band { fill: var(--blue); opacity: .18; }
.bar { width: 10rem; height: 1rem; max-width: none; display: block; }
.before { fill: var(--gray); } .after { fill: var(--blue); } .null { fill: var(--ink); }
.key { display: inline-block; width: .7rem; height: .7rem; margin-right: .35rem; }
.gray { background: var(--gray); } .blue { background: var(--blue); }
.line { background: var(--ink); width: .14rem; height: .9rem; vertical-align: -.1rem; }
code { font-size: .92em; background: var(--faint); padding: 0 .25rem; }
pre { background: var(--faint); padding: .5rem .7rem; overflow-x: auto; }
pre code { background: none; padding: 0; }
$style</style></head><body>
$body
</body></html>
"""
)


def html_page(title: str, style: str, body: str) -> str:
    """
    Return a page that needs no other file; the title is plain text and escaped here.

    ``style`` is CSS of this page, added to the common style; ``body`` is HTML.
    """
    return _PAGE.substitute(title=escape(title), style=style, body=body)
