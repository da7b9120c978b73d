"""The images of one frame in the making, on the device, and the launches that make it."""

from collections.abc import Sequence
from functools import cached_property
import math
from typing import Any

from flexx2_sim_ros.batch import edge_kernels, kernels
from flexx2_sim_ros.batch.arrays import PIXELS_A_THREAD
from flexx2_sim_ros.batch.effect_tables import Effects, effects_row, Light, light_row, noise_row
from flexx2_sim_ros.batch.frame import BORDER, Frame, Lens, Noise, SPREAD
from flexx2_sim_ros.batch.host import without_kernel
from flexx2_sim_ros.camera import Intrinsics, Mode
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.modes import Profile
import numpy as np
import warp as wp

# Environments whose images are made at a time: on the CPU so that they stay in the cache, on CUDA
# so that the chip is full; and the threads for pixels that need one. `bench.batch_gpu` compares.
AT_A_TIME = {'cpu': 8, 'cuda': 512}
MOST_PIXELS = 2**31 - 1  # of an array of Warp
THREADS_FOR_LISTED = 1024  # of an environment, where there are many
_ON_ALL_SURFACES = 1.0, 1.0, 0.0  # noise that does not depend on the surface


def many_threads(device: Any) -> bool:
    """Say whether a thread gets a few pixels only, instead of a row or more."""
    return bool(device.is_cuda)


class Rows:
    """
    The mode, effects, key and stamps of each environment, (N,) arrays on the device.

    They begin at stamp 0, with `keys`, (N, 2) uint32; modes and effects are to be set.
    """

    def __init__(self, keys: np.ndarray, device: Any) -> None:
        """Allocate them."""

        def zeros(dtype: Any) -> wp.array:
            return wp.zeros(len(keys), dtype=dtype, device=device)

        # Of its mode; coefficients are those of `formulas.surfaces.surface_factor`.
        self.noises, self.lights = zeros(Noise), zeros(Light)
        self.surface_noise = zeros(wp.vec3f)
        self.periods = zeros(wp.int64)  # nanoseconds from frame to frame
        self.effects = zeros(Effects)
        self.latencies, self.delays = zeros(wp.int64), zeros(wp.int64)  # ns, of its `TimeOffset`
        self.keys = wp.array(keys, dtype=wp.vec2ui, device=device)  # of its random numbers
        self.stamps = zeros(wp.int64)  # nanoseconds
        self.is_due = zeros(wp.uint8)  # 1: this call takes a frame; else nothing is kept of it
        # 1 where the next frame is the first one for its effects, and where this one is:
        self.was_reset, self.is_first = zeros(wp.uint8), zeros(wp.uint8)
        # Stamps of the first frame, of this one and of the one before, nanoseconds:
        self.started, self.last, self.before = (zeros(wp.int64) for _ in range(3))

    def set_modes(
        self, modes: Sequence[Mode], effects: Sequence[tuple[Effect, ...]], profile: Profile
    ) -> None:
        """
        Put the numbers of the mode of every environment on the device.

        A captured graph reads the same memory again. Raises InputError for effects that need
        frequencies in a mode without.
        """
        pairs = list(zip(modes, effects, strict=True))
        noises = {(mode, own): noise_row(mode, own) for mode, own in set(pairs)}
        layout = Noise.numpy_dtype()  # type: ignore
        self.noises.assign(np.array([noises[pair] for pair in pairs], layout))
        lights = {mode: light_row(mode, profile) for mode in set(modes)}
        self.lights.assign(np.array([lights[mode] for mode in modes]))
        surfaces = [
            mode.noise.surfaces.coefficients if mode.noise.surfaces else _ON_ALL_SURFACES
            for mode in modes
        ]
        self.surface_noise.assign(np.array(surfaces, np.float32))
        self.periods.assign(np.array([mode.period_ns for mode in modes]))

    def set_effects(self, effects: Sequence[tuple[Effect, ...]]) -> None:
        """Put the effects of every environment on the device; none where one has no kernel."""
        offsets = [time_offset_of(own) for own in effects]
        rows = {own: effects_row(() if without_kernel(own) else own) for own in set(effects)}
        self.effects.assign(np.array([rows[own] for own in effects]))
        self.latencies.assign(np.array([offset.latency_ns for offset in offsets]))
        self.delays.assign(np.array([offset.delay_ns for offset in offsets]))


def check_kept(name: str, longest_ns: int, pixels: int) -> None:
    """
    Raise InputError where frames of `pixels`, kept for `longest_ns`, do not fit into an array.

    `name` is the parameter that says how long; `pixels` are those of all environments.
    """
    if pixels > MOST_PIXELS:
        raise InputError(
            f'{name}: must be so short that at most {MOST_PIXELS} pixels are kept, got '
            f'{longest_ns / 1e9:g} s, for which {pixels} are'
        )


class Images:
    """
    Memory for frames of one size, used again for every frame.

    `rows` are of all environments, `camera` of their depth images; its distortion is not used.
    `invalid` is what invalid pixels are. ``frame`` is what kernels take: its `listed` says how
    many pixels of each environment are listed (every `SPREAD`), and `pixel_list` which: those that
    see another surface; with many threads those with a jump. Its `moved` is 0 everywhere between
    frames. ``out`` are finished frames, (N, H, W).
    """

    def __init__(self, rows: Rows, camera: Intrinsics, profile: Profile, invalid: float) -> None:
        """Allocate the memory."""
        self.rows, self.camera, self.profile = rows, camera, profile
        device, num_envs = rows.stamps.device, rows.stamps.size
        self.device = device
        self.height, self.width = camera.height, camera.width
        # Whether there are many threads, so that lists share out the work of a few pixels.
        self.lists = many_threads(device)
        # Environments in a pass, and in the pass at hand.
        self.most = self.count = min(num_envs, AT_A_TIME['cuda' if device.is_cuda else 'cpu'])
        self.pixels = self.most * self.height * self.width
        bordered = self.most * (self.height + BORDER) * (self.width + BORDER)
        blocks = 4 * self.most * self.blocks

        def zeros(size: int, dtype: Any = wp.float32) -> wp.array:
            return wp.zeros(size, dtype=dtype, device=device)

        frame = self.frame = Frame()
        frame.lens = frame.surfaces.lens = _lens(camera, profile, invalid)
        frame.chunk = min(PIXELS_A_THREAD, self.width) if self.lists else self.width
        frame.threads = THREADS_FOR_LISTED if self.lists else 1
        frame.pitch = self.pixels
        for name, row in vars(rows).items():
            if name in Frame.vars:  # type: ignore[attr-defined]
                setattr(frame, name, row)
        # The borders stay zero.
        frame.surfaces.p = zeros(bordered)
        frame.surfaces.jumps = zeros(bordered, wp.uint8)
        frame.moved = zeros(self.pixels, wp.uint16)
        frame.listed = zeros(self.most * SPREAD, wp.int32)
        frame.pixel_list = zeros(self.pixels, wp.int32)
        frame.normals = zeros(blocks)
        self._shape = (num_envs, self.height, self.width)
        self._nothing = zeros(0)
        self.out = wp.zeros(self._shape, dtype=wp.float32, device=device)
        outside = profile.sensor.outside(camera)
        self._outside = (
            None if outside is None else wp.array(outside.ravel(), dtype=wp.bool, device=device)
        )
        # Not while a graph is captured.
        for module in (kernels, edge_kernels):
            wp.load_module(module, device=device)

    @cached_property
    def staging(self) -> wp.array:
        """Return memory for depth images that are not contiguous, (N, H, W) float32."""
        return wp.zeros(self._shape, dtype=wp.float32, device=self.out.device)

    @cached_property
    def more_staging(self) -> wp.array:
        """Return the same for reflectivity."""
        return wp.zeros(self._shape, dtype=wp.float32, device=self.out.device)

    @property
    def blocks(self) -> int:
        """Return how many blocks of four random numbers the pixels of a frame need."""
        return -(-self.height * self.width // 4)

    def begin(self, first: int, reflectivity: wp.array | None, out: wp.array) -> None:
        """
        Begin a pass at environment `first`.

        `reflectivity` (or None) and `out` are (N * H * W,) float32, of all environments.
        """
        self.count = min(self.most, self._shape[0] - first)
        frame = self.frame
        frame.first = frame.surfaces.first_of_reflectivity = first
        frame.surfaces.reflectivity = self._nothing if reflectivity is None else reflectivity
        frame.out = out

    def end(self) -> None:
        """Let go of the caller's memory."""
        self.frame.surfaces.reflectivity = self.frame.out = self._nothing

    def each_pixel(self, kernel: Any, *more: Any) -> None:
        """Launch a kernel for all pixels of the pass."""
        launch(kernel, self.grid(self.count), self.frame, *more)

    def grid(self, count: int) -> tuple[int, int, int]:
        """Return the threads for the pixels of some environments."""
        return count, self.height, -(-self.width // self.frame.chunk)

    def each_listed(self, kernel: Any) -> None:
        """Launch a kernel for the listed pixels of the pass."""
        launch(kernel, (self.count, self.frame.threads), self.frame)

    def each_block(self, kernel: Any) -> None:
        """Launch a kernel for the random numbers of the pass, with the blocks of a thread."""
        chunk = 1 if self.lists else self.blocks
        launch(kernel, (self.count, self.blocks // chunk), self.frame, chunk)

    def find_surfaces(self, depth: wp.array, first: int) -> None:
        """Find surfaces and jumps in flat float32 depth images, from the first of them on."""
        self.each_pixel(kernels.invert, depth, first)
        self.each_pixel(kernels.list_jumps if self.lists else kernels.find_jumps)

    def move_edges(self) -> None:
        """Move the edges, into `moved`."""
        if self.lists:
            self.each_listed(edge_kernels.mark_edges)
            self.each_listed(edge_kernels.move_marked)
            return
        for column, lines in enumerate((self.height, self.width)):
            launch(edge_kernels.move_edges, (self.count, lines), self.frame, column)

    def draw_normals(self) -> None:
        """Draw the axial noise's normals."""
        self.each_block(kernels.draw_normals)

    def observe(self) -> None:
        """Write the frames, after `find_surfaces` and `move_edges`."""
        if self.lists:
            launch(kernels.observe_blocks, (self.count, self.blocks), self.frame)
        else:
            self.draw_normals()
            self.each_pixel(kernels.observe_rows)
            self.each_listed(kernels.observe_moved)

    def blank_outside(self, out: wp.array) -> None:
        """Blank all environments' (N * H * W,) float32 frames outside of the valid region."""
        self._blank(self._shape[0], self.frame.lens.invalid, out)

    def blank_measured(self) -> None:
        """Do so with the measured depth of the pass, before filters mix neighbours."""
        self._blank(self.count, math.nan, self.frame.measured)

    def _blank(self, count: int, invalid: float, out: wp.array) -> None:
        if self._outside is not None:
            threads = (count, self._outside.size)
            launch(kernels.blank_outside, threads, self._outside, invalid, out)


def launch(kernel: Any, threads: Any, *values: Any) -> None:
    """Launch a kernel on the current device."""
    wp.launch(kernel, threads, values)


def _lens(camera: Intrinsics, profile: Profile, invalid: float) -> Any:
    sensor = profile.sensor
    lens = Lens()
    lens.fx, lens.fy, lens.cx, lens.cy = camera.fx, camera.fy, camera.cx, camera.cy
    lens.height, lens.width = camera.height, camera.width
    lens.jump_share, lens.steep_share = sensor.jump_share, sensor.steep_share
    lens.cap = profile.modes[0].noise.incidence_cap
    lens.neighbourhood = sensor.neighbourhood_px
    lens.invalid = invalid
    return lens
