"""Effects in a batch on what each pixel sees: pose_error, intrinsics_error and time_offset."""

from collections.abc import Sequence
import math
from typing import Any

from flexx2_sim_ros.batch.arrays import at, put
from flexx2_sim_ros.batch.compiled import compiled
from flexx2_sim_ros.batch.frame import Frame, OPTIONS, padded, place, Surfaces
from flexx2_sim_ros.batch.history import each_with, FrameHistory, needs_of
from flexx2_sim_ros.batch.images import Images, launch
from flexx2_sim_ros.batch.kernels import slopes
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.effects import Effect, pose_error
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.formulas import surfaces as surface_formulas
from flexx2_sim_ros.physics.geometry import Reprojection
import numpy as np
import warp as wp

wp.set_module_options(OPTIONS)

_NAN = wp.constant(wp.float32(math.nan))
_NEAREST = wp.constant(wp.float32(pose_error.NEAREST))
_MOST_STEPS = wp.constant(wp.float32(pose_error.MOST_STEPS))

_turned_ray = compiled(pose_error.turned_ray)
_depth_ratio = compiled(pose_error.depth_ratio)
_place_at = compiled(pose_error.place_at)
_pixel_at = compiled(pose_error.pixel_at)
_parallax = compiled(pose_error.parallax)
_closest_seen = compiled(pose_error.closest_seen)
_is_near = compiled(pose_error.is_near)
_depth_of_plane = compiled(pose_error.depth_of_plane)
_plane_normal = compiled(surface_formulas.plane_normal)
_beside = compiled(surface_formulas.beside)


@wp.struct
class Pose:
    """Where an environment's camera is, seen from where it is thought to be."""

    moved: wp.int32
    rotation: wp.mat33f
    step: wp.vec3f


@wp.func
def show(
    s: Surfaces,
    n: wp.int32,
    pixel: wp.int32,
    source: wp.int32,
    seen: wp.float32,
    depth: wp.array(dtype=wp.float32),
    reflectivity: wp.array(dtype=wp.float32),
):
    """Write what a pixel sees: depth ``seen`` and the reflectivity of pixel ``source``."""
    pixels = s.lens.height * s.lens.width
    put(depth, n * pixels + pixel, seen)
    if s.reflectivity.shape[0] > 0:
        rho = at(s.reflectivity, (s.first_of_reflectivity + n) * pixels + source)
        put(reflectivity, n * pixels + pixel, rho)


@wp.func
def _shown_at(
    s: Surfaces, n: wp.int32, ray: wp.vec3f, step: wp.vec3f, inverse: wp.float32
) -> wp.float32:
    lens = s.lens
    ratio = _depth_ratio(ray[2], step[2], inverse)
    column = _pixel_at(
        _place_at(ray[0], step[0], inverse, ratio, lens.fx, lens.cx), lens.width - 1
    )
    row = _pixel_at(_place_at(ray[1], step[1], inverse, ratio, lens.fy, lens.cy), lens.height - 1)
    return at(s.p, padded(lens, n, row, column))


@wp.func
def _in_front(
    s: Surfaces, n: wp.int32, ray: wp.vec3f, step: wp.vec3f, inverse: wp.float32
) -> wp.float32:
    # As in `effects.pose_error`.
    lens = s.lens
    closest = _closest_seen(ray[2], step[2])
    far = _depth_ratio(ray[2], step[2], inverse)
    close = _depth_ratio(ray[2], step[2], closest)
    if inverse >= closest or far < _NEAREST or close < _NEAREST:
        return inverse
    path = _parallax(
        _place_at(ray[0], step[0], inverse, far, lens.fx, lens.cx),
        _place_at(ray[1], step[1], inverse, far, lens.fy, lens.cy),
        _place_at(ray[0], step[0], closest, close, lens.fx, lens.cx),
        _place_at(ray[1], step[1], closest, close, lens.fy, lens.cy),
    )
    pixel = (closest - inverse) / wp.max(path, 1.0)
    steps = wp.int32(wp.min(path + 0.5, _MOST_STEPS))
    free = wp.float32(inverse)
    k = wp.int32(steps)
    while k > 0:
        there = wp.min(inverse + wp.float32(k) * pixel, closest)
        here = _shown_at(s, n, ray, step, there)
        if _is_near(here, there, pixel):
            again = _shown_at(s, n, ray, step, here)
            if _is_near(again, here, 0.5 * pixel):
                return here
        if here < there:
            free = there
        k -= 1
    if steps > 0 and _shown_at(s, n, ray, step, inverse) > inverse + pixel:
        return free
    return inverse


@wp.kernel
def look_from(
    f: Frame,
    poses: wp.array(dtype=Pose),
    depth: wp.array(dtype=wp.float32),
    reflectivity: wp.array(dtype=wp.float32),
):
    """Write what a camera at another pose sees: the effect pose_error."""
    n, y, x = wp.tid()
    lens = f.lens
    pose = poses[f.first + n]
    step = pose.step
    pixel = y * lens.width + x
    inverse = at(f.surfaces.p, padded(lens, n, y, x))
    source = wp.int32(pixel)
    out = wp.where(inverse > 0.0, 1.0 / inverse, _NAN)
    if pose.moved == 1:
        dx, dy, dz = _turned_ray(
            pose.rotation[0],
            pose.rotation[1],
            pose.rotation[2],
            (wp.float32(x) - lens.cx) / lens.fx,
            (wp.float32(y) - lens.cy) / lens.fy,
        )
        nearest = _in_front(f.surfaces, n, wp.vec3f(dx, dy, dz), step, inverse)
        far = _depth_ratio(dz, step[2], nearest)
        out = _NAN
        source = wp.int32(0)
        if far >= _NEAREST:
            place_x = _place_at(dx, step[0], nearest, far, lens.fx, lens.cx)
            place_y = _place_at(dy, step[1], nearest, far, lens.fy, lens.cy)
            column = _pixel_at(place_x, lens.width - 1)
            row = _pixel_at(place_y, lens.height - 1)
            source = row * lens.width + column
            i = padded(lens, n, row, column)
            here = at(f.surfaces.p, i)
            if here > 0.0:
                d = slopes(f.surfaces, i)
                u = wp.float32(column) - lens.cx
                v = wp.float32(row) - lens.cy
                nx, ny, nz = _plane_normal(here, d[0], d[1], u, v, lens.fx, lens.fy)
                out = _depth_of_plane(nx, ny, nz, dx, dy, dz, step[0], step[1], step[2])
    show(f.surfaces, n, pixel, source, out, depth, reflectivity)


@wp.kernel
def look_up(
    f: Frame,
    views: wp.array(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
    du: wp.array(dtype=wp.float32),
    dv: wp.array(dtype=wp.float32),
    depth: wp.array(dtype=wp.float32),
    reflectivity: wp.array(dtype=wp.float32),
):
    """
    Write what is seen along other rays: the effect intrinsics_error.

    ``views`` says for each environment which rays, -1 for its own. ``index``, ``du`` and ``dv``
    are from `physics.geometry.Reprojection.lines`.
    """
    n, y, x = wp.tid()
    pixel = y * f.lens.width + x
    view = views[f.first + n]
    inverse = at(f.surfaces.p, padded(f.lens, n, y, x))
    source = wp.int32(pixel)
    if view >= 0:
        entry = place(f.lens, view, y, x)
        source = index[entry]
        inverse = 0.0
        if source >= 0:
            row = source // f.lens.width
            i = padded(f.lens, n, row, source - row * f.lens.width)
            here = at(f.surfaces.p, i)
            d = slopes(f.surfaces, i)
            if here > 0.0:
                inverse = _beside(here, d[0], d[1], at(du, entry), at(dv, entry))
    out = wp.where(inverse > 0.0, 1.0 / inverse, _NAN)
    show(f.surfaces, n, pixel, wp.max(source, 0), out, depth, reflectivity)


_MOST_VIEWS = 64  # of intrinsics_error; each takes three numbers a pixel


class SceneGeometry:
    """
    What the environments of a pass see, after the effects of geometry and time.

    `effects` are of every environment, those that are on; `latest_ns` is the longest latency that
    an environment may have, nanoseconds.
    """

    def __init__(
        self, effects: Sequence[Sequence[Effect]], latest_ns: int, images: Images
    ) -> None:
        """Put the parameters on the device and allocate the images."""
        self._images, device = images, images.device
        needs = needs_of(effects)

        def image() -> wp.array:
            return wp.zeros(images.pixels, dtype=wp.float32, device=device)

        # Each kernel with its parameters, and its own images of depth and reflectivity.
        self._steps: list[tuple[Any, tuple[Any, ...], wp.array, wp.array]] = []
        if 'pose' in needs:
            poses = (_poses(effects, device),)
            self._steps.append((look_from, poses, image(), image()))
        if 'view' in needs:
            views = _views(effects, images.camera, device)
            self._steps.append((look_up, views, image(), image()))
        self._history = FrameHistory(effects, latest_ns, images) if 'history' in needs else None
        if self._steps:
            wp.load_module(__name__, device=device)

    def begin(self, with_reflectivity: bool) -> None:
        """Register a new frame in all environments; see `FrameHistory.begin`."""
        if self._history is not None:
            self._history.begin(with_reflectivity)

    def look(self, depth: wp.array) -> None:
        """Find the surfaces that the environments of the pass see, from all clean depth."""
        images, frame = self._images, self._images.frame
        first = frame.first
        if self._steps or self._history is None:
            images.find_surfaces(depth, first)
        threads = (images.count, images.height, images.width)
        for kernel, parameters, *seen in self._steps:
            launch(kernel, threads, frame, *parameters, *seen)
            depth, first = seen[0], 0
            self._show(*seen)
        if self._history is not None:
            self._show(*self._history.look_back(depth, first))

    def _show(self, depth: wp.array, reflectivity: wp.array) -> None:
        # What the environments of the pass see from now on.
        self._images.find_surfaces(depth, 0)
        frame = self._images.frame
        if frame.surfaces.reflectivity.size and reflectivity.size:
            frame.surfaces.reflectivity, frame.surfaces.first_of_reflectivity = reflectivity, 0


def _poses(effects: Sequence[Sequence[Effect]], device: Any) -> wp.array:
    layout = np.dtype(Pose.numpy_dtype())  # type: ignore
    rows: Any = np.zeros(len(effects), layout)
    for row, own in zip(rows, effects, strict=True):
        for effect in own:
            if 'pose' in (effect.batched or ()):
                row['moved'] = 1
                row['rotation'], row['step'] = effect.motion()  # type: ignore[attr-defined]
    return wp.array(rows, dtype=Pose, device=device)


def _views(
    effects: Sequence[Sequence[Effect]], camera: Intrinsics, device: Any
) -> tuple[wp.array, ...]:
    chosen = each_with('view', effects)
    different = list({effect: None for effect in chosen if effect is not None})
    if len(different) > _MOST_VIEWS:
        raise InputError(
            f'effects: {different[0].name}: must have at most {_MOST_VIEWS} different sets of '
            f'parameters in a batch, got {len(different)}'
        )
    lines = [Reprojection(effect.true_camera(camera), camera).lines for effect in different]
    index, du, dv = (np.concatenate(parts) for parts in zip(*lines, strict=True))
    views = np.array([-1 if effect is None else different.index(effect) for effect in chosen])
    return (
        wp.array(views, dtype=wp.int32, device=device),
        wp.array(index, dtype=wp.int32, device=device),
        *(wp.array(part, dtype=wp.float32, device=device) for part in (du, dv)),
    )
