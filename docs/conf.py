"""Configuration of the documentation site: the pages in docs/ and the API, from docstrings."""

from functools import cached_property
from pathlib import Path
import re
import sys
from typing import Any, cast

from sphinx.application import Sphinx
from sphinx.domains.python import PythonDomain

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from flexx2_sim_ros import __version__  # noqa: E402,I100

project = 'flexx2_sim_ros'
author = 'flexx2_sim_ros maintainers'
copyright = author  # noqa: A001
version = release = __version__

extensions = ['myst_parser', 'sphinx.ext.apidoc', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
html_theme = 'furo'
html_title = 'flexx2_sim_ros'
exclude_patterns = ['_build']

# The API pages are made anew at every build, of the rooms that a user's program calls. The nodes
# are described by their topics and parameters (nodes.md), kernels by the functions that run them.
apidoc_modules = [
    {
        'path': '../flexx2_sim_ros',
        'destination': 'api',
        'separate_modules': False,  # A page for each module takes twice as long.
        'module_first': True,
        'max_depth': 2,
        'exclude_patterns': [
            *(f'**/{room}/**' for room in ('cli', 'nodes', 'view')),
            *(f'**/gap/{room}/**' for room in ('data', 'features', 'inference', 'report')),
            '**/*kernels.py',
            '**/batch/compiled.py',
            '**/batch/effect_formulas.py',
            '**/batch/effect_tables.py',
        ],
    }
]
apidoc_automodule_options = {'members'}  # A class's docstring describes its fields.
autodoc_typehints = 'signature'  # The docstrings say shapes and units.
autodoc_member_order = 'bysource'
autodoc_use_type_comments = False  # There are none, and looking for them takes a while.
autodoc_preserve_defaults = True  # `edges=EDGES`, not the array's numbers.
add_module_names = False
toc_object_entries = False  # Modules are enough there, and the build takes half the time.
default_role = 'code'
autodoc_default_options = {'ignore-module-all': True}  # What a package re-exports is listed once.
napoleon_google_docstring = False
napoleon_use_ivar = True
myst_heading_anchors = 3
suppress_warnings = ['ref.python']  # A field of one name in several classes is no error.

# Pages of the site that show a file of the repository's top folder.
TOP_FILES = {name: f'{name.lower()}.md' for name in ('README', 'CONTRIBUTING', 'ARCHITECTURE')}


def point_into_the_site(text: str) -> str:
    """Return Markdown with links to files of the top folder replaced by pages of this site."""
    pattern = rf'\]\((?:\.\./)?({"|".join(TOP_FILES)})\.md'
    return re.sub(pattern, lambda found: f']({TOP_FILES[found[1]]}', text)


def read_page(_app: Sphinx, _page: str, content: list[str]) -> None:
    """Adapt the links of a page in docs/."""
    content[0] = point_into_the_site(content[0])


def read_included(_app: Sphinx, _path: Path, _page: str, content: list[str]) -> None:
    """Adapt the links of a file that a page includes."""
    content[0] = point_into_the_site(content[0])


def join_names(_app: Sphinx, *about: object) -> None:
    """Write `a,b : float` for `a, b : float`: napoleon takes `a,` of attributes for a type."""
    lines = cast(list[str], about[-1])
    lines[:] = [
        line.replace(', ', ',') if re.match(r'\s*\w+(, \w+)+ : ', line) else line for line in lines
    ]


class Names(PythonDomain):
    """Searches for names of this package only: those of others took a fifth of the build."""

    @cached_property
    def last_parts(self) -> set[str]:
        """Return what the names of objects end with; all pages have been read."""
        return {name.rpartition('.')[2] for name in self.objects}

    def find_obj(self, env: Any, modname: str, classname: str, name: str, *how: Any) -> Any:
        """Return the objects of a name."""
        if name.rpartition('.')[2].removesuffix('()') not in self.last_parts:
            return []
        return super().find_obj(env, modname, classname, name, *how)


def setup(app: Sphinx) -> dict[str, bool]:
    """Let texts pass through the functions above, in as many processes as sphinx starts."""
    app.add_domain(Names, override=True)
    app.connect('autodoc-process-docstring', join_names, priority=100)
    app.connect('source-read', read_page)
    app.connect('include-read', read_included)
    return {'parallel_read_safe': True}
