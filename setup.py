"""Build flexx2_sim_ros for colcon (ament_python) and for pip alike."""

import os
from pathlib import Path
import subprocess
import sys
from xml.etree import ElementTree

from setuptools import find_packages, setup
from setuptools.command.install import install

NAME = 'flexx2_sim_ros'
HERE = Path(__file__).resolve().parent  # colcon build --symlink-install links to this file
SHARE = Path('share') / NAME
# Version, maintainer and licence are in package.xml alone.
MANIFEST = ElementTree.parse(HERE / 'package.xml').getroot()
MAINTAINER = MANIFEST.find('maintainer')
HAS_WHEEL = '; platform_machine != "aarch64"'

# Parts of the package that need more; `all` is all of them, but ROS.
EXTRAS = {
    'bags': ['rosbags>=0.11'],
    'cluster': ['distributed>=2024.1'],
    'cost': [f'pyoctomap>=1.2.2{HAS_WHEEL}'],
    'figures': ['matplotlib>=3.7'],
    'gap': ['matplotlib>=3.7', 'rosbags>=0.11', 'scikit-learn>=1.4', 'threadpoolctl>=3.1'],
    'hdf5': ['h5py>=3.8'],
    'lerobot': ['av>=15.0', 'pyarrow>=15.0'],
    'menagerie': ['mujoco-menagerie'],
    'mujoco': ['mujoco>=3.5'],
    'truth': [f'embreex>=2.17{HAS_WHEEL}', 'opencv-python-headless>=4.7', 'trimesh>=4.5'],
    'view': ['tornado>=6.4'],
}
EXTRAS['truth'] += EXTRAS['gap']
EXTRAS['all'] = sorted({one for extra in EXTRAS.values() for one in extra})
EXTRAS['ros'] = [  # Both nodes, and the demo.
    'matplotlib>=3.7',
    'mujoco>=3.5',
    'ros-jazzy-common-interfaces',
    'ros-jazzy-rclpy[fastrtps]',
    'rosbags>=0.11',
    'tornado>=6.4',
]
EXTRAS['test'] = EXTRAS['all'] + [
    'build',
    'colcon-common-extensions',
    'flake8',
    'flake8-blind-except',
    'flake8-builtins',
    'flake8-class-newline',
    'flake8-comprehensions',
    'flake8-deprecated',
    'flake8-docstrings',
    'flake8-import-order',
    'flake8-quotes',
    'foxglove-sdk>=0.30',
    'furo',
    'hypothesis',
    'mcap',
    'mypy',
    'myst-parser',
    'pydocstyle',
    'pypdfium2',
    'pytest',
    'pytest-xdist',
    'ruff',
    'sphinx',
    'twine',
    'types-PyYAML',
    'xacro',
]

shared_files: dict[str, list[str]] = {}
for path in sorted([*(HERE / 'config').rglob('*'), *(HERE / 'launch').glob('*.launch.py')]):
    if path.is_file():
        name = path.relative_to(HERE)
        shared_files.setdefault(str(SHARE / name.parent), []).append(str(name))


class Install(install):
    """Install; where the package will run from there (colcon), compile the camera as well."""

    def run(self) -> None:
        """Install. Failing to compile is no failure: the first start does it then."""
        super().run()
        if self.root is not None:  # a wheel or a Debian package, for another machine
            return
        paths = [self.install_lib, *filter(None, [os.environ.get('PYTHONPATH')])]
        done = subprocess.run(
            [sys.executable, '-m', f'{NAME}.cli.main', 'compile', '--no-effects'],
            cwd=self.install_lib,
            env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths)},
            capture_output=True,
            text=True,
            check=False,
        )
        print(done.stdout if done.returncode == 0 else 'the camera is not compiled yet')


setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    description='A simulated PMD Flexx2 time-of-flight camera for ROS 2, and tools for its noise',
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get('email'),
    url=MANIFEST.findtext('url'),
    license=MANIFEST.findtext('license'),
    python_requires='>=3.11',
    packages=find_packages(str(HERE), include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed'], f'{NAME}.view': ['page/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (str(SHARE), ['package.xml']),
        *shared_files.items(),
    ],
    # Each has wheels for x86-64, aarch64 and macOS: test/test_platforms.py.
    install_requires=[
        'numba>=0.59',
        'numpy>=1.26',
        'pillow>=10.0',
        'PyYAML>=6.0.1',
        'rich>=13.0',
        'scipy>=1.11',
        'warp-lang>=1.17',
    ],
    extras_require=EXTRAS,
    entry_points={
        'console_scripts': [
            'flexx2 = flexx2_sim_ros.cli.main:main',
            'flexx2_camera = flexx2_sim_ros.nodes.flexx2_camera:main',
            'go1_cameras = flexx2_sim_ros.nodes.go1_cameras:main',
        ]
    },
    cmdclass={'install': Install},
    zip_safe=False,
)
