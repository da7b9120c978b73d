"""Printed targets: rows of square tags on a sheet of paper, as YAML, as an image and as a PDF."""

from dataclasses import asdict, dataclass, fields
from io import BytesIO
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import read_section
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.profiles.section import Section
from flexx2_sim_ros.truth.printed import square_corners, Tagged
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
import numpy as np
import yaml

# ISO 216 sheets in landscape: side of a tag and gap between two, metres. Tags are as large as a
# white border of 10 mm allows, because larger tags are found from farther away.
SHEETS = {
    'A4': (0.297, 0.210, 0.080, 0.018),
    'A3': (0.420, 0.297, 0.115, 0.025),
    'A2': (0.594, 0.420, 0.165, 0.030),
}
DICTIONARIES = (
    'DICT_4X4_50', 'DICT_5X5_50', 'DICT_6X6_50', 'DICT_APRILTAG_16h5', 'DICT_APRILTAG_36h11',
)  # fmt: skip
_LEAST_BORDER = 0.005  # metres of white around the tags; printers leave such a border
_LEAST_GAP = 0.5  # of a module
_INCH = 0.0254
_RULERS = 0.2, 0.1  # metres, along and across


@dataclass(frozen=True)
class Target(Tagged):
    """A flat sheet with tags, numbered from left to right, then downwards."""

    dictionary: str = 'DICT_4X4_50'  # one of `DICTIONARIES`
    columns: int = 3
    rows: int = 2
    first_id: int = 0  # number of the first tag
    tag: float = SHEETS['A3'][2]  # side of a tag with its black border, metres
    gap: float = SHEETS['A3'][3]  # white gap between two tags, metres
    width: float = SHEETS['A3'][0]
    height: float = SHEETS['A3'][1]
    white: float = 0.8
    black: float = 0.05  # reflectivity at the camera's wavelength, 0 to 1
    flatness: float = 0.001
    scale_error: float = 0.001

    def __post_init__(self) -> None:
        """Check that the tags fit on the sheet and can be found."""
        for name, side, count in (
            ('width', self.width, self.columns),
            ('height', self.height, self.rows),
        ):
            least = count * self.tag + (count - 1) * self.gap + 2 * _LEAST_BORDER
            if side < least - 1e-9:
                raise InputError(
                    f'{name}: must be at least {least:g} m, for {count} tags of {self.tag:g} m, '
                    f'gaps of {self.gap:g} m and a white border of 5 mm, got {side:g}'
                )
        module = self.tag / len(self.modules(0))
        if self.gap < _LEAST_GAP * module:
            raise InputError(
                f'gap: must be at least half a module of a tag, {_LEAST_GAP * module:.4f} m, got '
                f'{self.gap:g}'
            )
        last = self.first_id + self.columns * self.rows
        known = len(self.codes().bytesList)
        if last > known:
            raise InputError(f'first_id: must be at most {known - last + self.first_id}')

    @property
    def size(self) -> tuple[float, float]:
        return self.width, self.height

    def modules(self, number: int) -> np.ndarray:
        """Return (M, M) bool of the tag with this place in the sheet: True for black."""
        codes = self.codes()
        image = codes.generateImageMarker(self.first_id + number, codes.markerSize + 2)
        return np.asarray(image) < 128

    def places(self) -> np.ndarray:
        """Return (N, 2) upper left corners of the tags in the sheet's frame, metres."""
        step = self.tag + self.gap
        start = -np.array([self.columns, self.rows]) * step / 2 + self.gap / 2
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        return np.asarray(start + np.stack([column, row], axis=1) * step)

    def corners(self) -> np.ndarray:
        return square_corners(self.places(), self.tag)

    def paint(self, step: float) -> np.ndarray:
        width, height = (max(round(side / step), 1) for side in self.size)
        image = np.ones((height, width), np.float32)
        for number, place in enumerate(self.places()):
            black = self.modules(number)
            across, down = (
                _coverage(start, self.tag / len(black), len(black), size, step)
                for start, size in zip(place, (width, height), strict=True)
            )
            image -= down.T @ black.astype(np.float32) @ across
        return image

    def to_yaml(self) -> str:
        """Return the text of ``target.yaml``."""
        return yaml.safe_dump({'schema': 1, 'target': asdict(self)}, sort_keys=False)


_WHOLE = {'columns': (1, 50), 'rows': (1, 50), 'first_id': (0, 1000)}
_LIMITS = {
    'tag': (0.01, 2.0), 'gap': (0.001, 2.0), 'width': (0.02, 5.0), 'height': (0.02, 5.0),
    'white': (0.01, 1.0), 'black': (0.0, 1.0), 'flatness': (0.0, 0.05), 'scale_error': (0.0, 0.05),
}  # fmt: skip
_NEEDED = 'tag', 'gap', 'width', 'height', 'columns', 'rows'


def _coverage(start: float, module: float, count: int, size: int, step: float) -> np.ndarray:
    # (count, size) float32: the fraction of each pixel that each module covers, along one axis.
    pixel = (np.arange(size) - size / 2) * step
    edge = start + np.arange(count)[:, None] * module
    overlap = np.minimum(edge + module, pixel + step) - np.maximum(edge, pixel)
    return (np.clip(overlap, 0, None) / step).astype(np.float32)


def target_of(sheet: str) -> Target:
    """Return the standard target for one of `SHEETS`; raises `InputError` for another sheet."""
    if sheet not in SHEETS:
        raise InputError(f'--size: must be one of {", ".join(SHEETS)}, got {shown(sheet)}')
    width, height, tag, gap = SHEETS[sheet]
    return Target(tag=tag, gap=gap, width=width, height=height)


def read_target(path: Path) -> Target:
    """Read ``target.yaml``; raises `InputError` for one that cannot be read, printed or found."""
    file, content = f'{shown_path(path)}: ', read_section(path, 'target', dict)
    row = Section(file, 'target', content, _NEEDED, tuple(one.name for one in fields(Target)))
    values: dict[str, Any] = {
        name: row.whole(name, *_WHOLE[name]) for name in _WHOLE if row.has(name)
    }
    values |= {name: row.number(name, *_LIMITS[name]) for name in _LIMITS if row.has(name)}
    if row.has('dictionary'):
        values['dictionary'] = row.one_of('dictionary', DICTIONARIES)
    try:
        return Target(**values)
    except InputError as error:
        raise InputError(f'{file}{error}') from error


def draw_pdf(target: Target) -> bytes:
    """Draw a target as a PDF of one page, true to scale, with two rulers in its white border."""
    page = Figure(figsize=(target.width / _INCH, target.height / _INCH))
    axes = page.add_axes((0, 0, 1, 1))
    axes.set_xlim(-target.width / 2, target.width / 2)
    axes.set_ylim(target.height / 2, -target.height / 2)
    axes.set_axis_off()
    for number, place in enumerate(target.places()):
        axes.add_patch(PathPatch(_outline(target, number, place), facecolor='black', linewidth=0))
    for axis, reach in enumerate(_RULERS):
        _draw_ruler(axes, target, axis, reach)
    file = BytesIO()
    # Without a date, the same target is the same file.
    page.savefig(file, format='pdf', metadata={'CreationDate': None})
    return file.getvalue()


def _outline(target: Target, number: int, place: np.ndarray) -> Outline:
    # One path for all black modules of a tag: separate ones leave white hairlines between them.
    black = target.modules(number)
    module = target.tag / len(black)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
    corners = np.argwhere(black)[:, None, ::-1] + square
    points = (place + corners * module).reshape(-1, 2)
    kinds = [Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY]
    return Outline(points, kinds * int(black.sum()))


def _draw_ruler(axes: Any, target: Target, axis: int, reach: float) -> None:
    sides = np.array(target.size)
    reach = math.floor(min(reach, 0.7 * sides[axis]) * 100) / 100
    # From 5 mm inside the sheet's edge towards the tags, in gray: the camera does not see it.
    edge = (1 if axis == 0 else -1) * (sides[1 - axis] / 2 - _LEAST_BORDER)
    inward = -math.copysign(1, edge)
    for k in range(round(reach * 100) + 1):
        along = -reach / 2 + k * 0.01
        length = 0.003 if k % 5 == 0 else 0.0015
        ends = np.array([[along, edge], [along, edge + inward * length]])[:, :: 1 - 2 * axis]
        axes.plot(*ends.T, color='0.6', linewidth=0.4)
    line = np.array([[-reach / 2, edge], [reach / 2, edge]])[:, :: 1 - 2 * axis]
    axes.plot(*line.T, color='0.6', linewidth=0.4)
    words = f'{reach * 1e3:.0f} mm'
    if axis == 0:
        words += ' exactly, or the print is not true to scale'
    place = np.array([0.0, edge + inward * 0.0035])[:: 1 - 2 * axis]
    axes.text(
        *place,
        words,
        color='0.6',
        fontsize=5,
        ha='center' if axis == 0 else 'left',
        va='bottom' if axis == 0 else 'center',
        rotation=90 * axis,
    )
