"""The documentation site, as `make docs` makes it."""

from html.parser import HTMLParser
from pathlib import Path
import re
import subprocess
import sys
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).resolve().parents[1]


class Links(HTMLParser):
    """The targets and the names of places of one HTML page."""

    def __init__(self, page):
        """Read the page."""
        super().__init__()
        self.targets = []
        self.places = set()
        self.feed(page.read_text(encoding='utf-8'))

    def handle_starttag(self, tag, attrs):
        """Collect what an element points to and what it is called."""
        for key, value in attrs:
            if key in ('href', 'src') and value:
                self.targets.append(value)
            elif key == 'id' and value:
                self.places.add(value)


@pytest.fixture(scope='module')
def site():
    """Build the site; a warning is an error."""
    pytest.importorskip('sphinx')
    make = ['make', '-s', '-o', '.venv/.complete', 'docs', f'BIN={Path(sys.executable).parent}']
    make.append('JOBS=1')  # Several cost more processor time, and other tests run beside this one.
    done = subprocess.run(make, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return ROOT / 'build' / 'docs'


def test_every_page_is_on_the_site(site):
    built = {path.stem for path in site.glob('*.html')}
    assert {path.stem for path in (ROOT / 'docs').glob('*.md')} <= built
    # Sphinx itself refuses pages that no table of contents names.
    assert {'readme', 'contributing', 'architecture', 'changelog'} <= built
    front = Links(site / 'index.html').targets
    assert {'readme.html', 'robots.html', 'api/modules.html'} <= set(front)


def test_links_lead_somewhere(site):
    pages = {path: Links(path) for path in site.rglob('*.html')}
    broken = []
    for page, links in pages.items():
        for link in links.targets:
            target = urlsplit(link)
            if target.scheme or target.netloc:
                continue
            file = (page.parent / unquote(target.path)).resolve() if target.path else page
            place = unquote(target.fragment)
            if not file.is_file() or (place and file in pages and place not in pages[file].places):
                broken.append(f'{page.relative_to(site)}: {link}')
    assert not broken


def test_the_reference_documents_the_public_functions(site):
    camera = Links(site / 'api' / 'flexx2_sim_ros.camera.html').places
    assert 'flexx2_sim_ros.camera.camera.Camera.capture' in camera
    diagnosis = Links(site / 'api' / 'flexx2_sim_ros.gap.html').places
    assert 'flexx2_sim_ros.gap.diagnosis.diagnose' in diagnosis


def test_measurements_that_pages_name_exist():
    pages = [*ROOT.glob('*.md'), *(ROOT / 'docs').glob('*.md'), *(ROOT / 'config').rglob('*.yaml')]
    named = {
        (page.name, name)
        for page in pages
        for name in re.findall(r'python\s+-m\s+bench\.(\w+)', page.read_text(encoding='utf-8'))
    }
    assert not {pair for pair in named if not (ROOT / 'bench' / f'{pair[1]}.py').is_file()}
