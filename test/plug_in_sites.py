"""Plug-ins on a path of their own, as an installation leaves them there."""

from contextlib import contextmanager
import importlib
from pathlib import Path
import shutil
import sys
import tomllib

from flexx2_sim_ros.effects import loadable, registry

EXAMPLE = Path(__file__).resolve().parents[1] / 'examples'


def install_example(site):
    """Put the example there with the metadata of its own pyproject.toml, and return the path."""
    project = tomllib.loads((EXAMPLE / 'pyproject.toml').read_text())
    (module,) = project['tool']['setuptools']['py-modules']
    site.mkdir(parents=True, exist_ok=True)
    shutil.copy(EXAMPLE / f'{module}.py', site)
    points = project['project']['entry-points']
    write_metadata(site, project['project']['name'], *points, **points[next(iter(points))])
    return site


def write_metadata(site, name, group='flexx2_sim_ros.effects', **points):
    """Write a distribution's metadata with entry points, and return the folder."""
    folder = site / f'{name.replace("-", "_")}-1.0.dist-info'
    folder.mkdir(parents=True)
    (folder / 'METADATA').write_text(f'Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n')
    lines = [f'{key} = {value}' for key, value in points.items()]
    (folder / 'entry_points.txt').write_text('\n'.join([f'[{group}]', *lines, '']))
    return folder


@contextmanager
def on_path(site):
    """Let this process find the plug-ins of a path, as long as the context lasts."""
    before = dict(sys.modules)

    def forget():
        importlib.invalidate_caches()
        registry.cache_clear()
        loadable.cache_clear()

    sys.path.insert(0, str(site))
    forget()
    try:
        yield
    finally:
        sys.path.remove(str(site))
        for name in set(sys.modules) - set(before):
            if str(getattr(sys.modules[name], '__file__', '')).startswith(str(site)):
                del sys.modules[name]
        forget()
