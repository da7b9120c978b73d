"""Configuration of the documentation site: the pages in docs/ and the API, from docstrings."""

from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from flexx2_sim_ros import __version__  # noqa: E402

project = 'flexx2_sim_ros'
author = 'flexx2_sim_ros maintainers'
copyright = author  # noqa: A001
version = release = __version__

extensions = ['myst_parser', 'sphinx.ext.apidoc', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
html_theme = 'furo'
html_title = 'flexx2_sim_ros'
exclude_patterns = ['_build']

# The API pages are made anew at every build.
apidoc_modules = [
    {
        'path': '../flexx2_sim_ros',
        'destination': 'api',
        'separate_modules': False,
        'module_first': True,
        'exclude_patterns': ['**/cli/**', '**/validation/**', '**/view/**'],
    }
]
autodoc_typehints = 'none'  # The docstrings say types, shapes and units.
autodoc_member_order = 'bysource'
autodoc_default_options = {'ignore-module-all': True}  # What a package re-exports is listed once.
napoleon_google_docstring = False
napoleon_use_ivar = True
myst_heading_anchors = 3
suppress_warnings = ['ref.python']  # A field of one name in several classes is no error.
