"""The images of one frame in the making, on the device, and the launches that make it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any

from flexx2_sim_ros.batch import edge_kernels, kernels, observe_kernels, region_kernels
from flexx2_sim_ros.batch.arrays import PIXELS_A_THREAD
from flexx2_sim_ros.batch.effect_tables import Effects, effects_row, noise_row
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


def many_threads(device: Any) -> bool:
    """Say whether a thread gets a few pixels only, instead of a row or more."""
    return bool(device.is_cuda)


@dataclass(frozen=True)
class Rows:
    """
    The mode, key and stamp of each environment, (N,) arrays on the device.

    Attributes
    ----------
    noise : warp.array
        `kernels.Noise`, of its mode.
    periods : warp.array
        int64, nanoseconds from frame to frame.
    effects : warp.array
        `Effects`.
    latencies, delays : warp.array
        int64, nanoseconds, of its `TimeOffset`.
    keys : warp.array
        vec2ui, of its random numbers.
    stamps : warp.array
        int64, nanoseconds.
    is_due : warp.array
        uint8, 1 where this call takes a frame.

    """

    noise: wp.array
    periods: wp.array
    effects: wp.array
    latencies: wp.array
    delays: wp.array
    keys: wp.array
    stamps: wp.array
    is_due: wp.array

    @classmethod
    def of(cls, keys: np.ndarray, device: Any) -> 'Rows':
        """Return rows with the (N, 2) uint32 keys, at stamp 0; modes and effects are to be set."""

        def zeros(dtype: Any) -> wp.array:
            return wp.zeros(len(keys), dtype=dtype, device=device)

        return cls(
            noise=zeros(kernels.Noise),
            periods=zeros(wp.int64),
            effects=zeros(Effects),
            latencies=zeros(wp.int64),
            delays=zeros(wp.int64),
            keys=wp.array(keys, dtype=wp.vec2ui, device=device),
            stamps=zeros(wp.int64),
            is_due=zeros(wp.uint8),
        )

    def set_modes(self, modes: Sequence[Mode], effects: Sequence[tuple[Effect, ...]]) -> None:
        """
        Put the noise and the period of the mode of every environment on the device.

        Raises
        ------
        InputError
            For effects that need frequencies in a mode without.

        """
        pairs = list(zip(modes, effects, strict=True))
        rows = {(mode, own): noise_row(mode, own) for mode, own in set(pairs)}
        layout = kernels.Noise.numpy_dtype()  # type: ignore
        self.noise.assign(np.array([rows[pair] for pair in pairs], layout))
        self.periods.assign(np.array([period_ns(mode) for mode in modes]))

    def set_effects(self, effects: Sequence[tuple[Effect, ...]]) -> None:
        """Put the effects of every environment on the device; none where one has no kernel."""
        offsets = [time_offset_of(own) for own in effects]
        rows = {own: effects_row(() if without_kernel(own) else own) for own in set(effects)}
        self.effects.assign(np.array([rows[own] for own in effects]))
        self.latencies.assign(np.array([offset.latency_ns for offset in offsets]))
        self.delays.assign(np.array([offset.delay_ns for offset in offsets]))


def period_ns(mode: Mode) -> int:
    """Return the time from frame to frame, nanoseconds."""
    return round(1e9 / mode.rate_hz)


def check_kept(name: str, longest_ns: int, pixels: int) -> None:
    """
    Check that frames which are kept for a time fit into an array.

    Parameters
    ----------
    name : str
        Of the parameter that says how long, for the error.
    longest_ns : int
        How long in the environment where it is longest.
    pixels : int
        Of the frames of all environments.

    Raises
    ------
    InputError
        When they are too many.

    """
    if pixels > MOST_PIXELS:
        raise InputError(
            f'{name}: must be so short that at most {MOST_PIXELS} pixels are kept, got '
            f'{longest_ns / 1e9:g} s, for which {pixels} are'
        )


class Images:
    """
    Memory for frames of one size, used again for every frame.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    camera : Intrinsics
        Of the depth images; its distortion is not used.
    profile : Profile
        Of the cameras.
    invalid : float
        What invalid pixels are.
    device : warp.Device
        Where.

    Attributes
    ----------
    height, width : int
    count : int
        Environments at a time.
    lens : kernels.Lens
    lists : bool
        Whether there are many threads, so that lists share out the work of a few pixels.
    listed, pixel_list : warp.array
        How many pixels of each environment at hand are listed (every `kernels.SPREAD`), and
        which, int32: those that see another surface; with many threads those with a jump.
    moved : warp.array
        Where pixels of the environments at hand take their values from, uint16; 0 everywhere
        between frames.
    out : warp.array
        (N, H, W) float32, finished frames.

    """

    def __init__(
        self, num_envs: int, camera: Intrinsics, profile: Profile, invalid: float, device: Any
    ) -> None:
        """Allocate the memory."""
        self.height, self.width = camera.height, camera.width
        self.lists = many_threads(device)
        self.count = min(num_envs, AT_A_TIME['cuda' if device.is_cuda else 'cpu'])
        self.lens = _lens(camera, profile, invalid)
        pixels = self.height * self.width
        bordered = (self.height + kernels.BORDER) * (self.width + kernels.BORDER)

        def zeros(size: int, dtype: Any) -> wp.array:
            return wp.zeros(self.count * size, dtype=dtype, device=device)

        # The borders stay zero.
        self._p = zeros(bordered, wp.float32)
        self._jumps = zeros(bordered, wp.uint8)
        self.moved = zeros(pixels, wp.uint16)
        self.listed = zeros(kernels.SPREAD, wp.int32)
        self.pixel_list = zeros(pixels, wp.int32)
        self._shape = (num_envs, self.height, self.width)
        self.out = wp.zeros(self._shape, dtype=wp.float32, device=device)
        outside = profile.sensor.outside(camera)
        self._outside = (
            None if outside is None else wp.array(outside.ravel(), dtype=wp.bool, device=device)
        )
        # Not while a graph is captured.
        for module in (kernels, edge_kernels, observe_kernels, region_kernels):
            wp.load_module(module, device=device)

    @cached_property
    def staging(self) -> wp.array:
        """Return memory for depth images that are not contiguous, (N, H, W) float32."""
        return wp.zeros(self._shape, dtype=wp.float32, device=self.out.device)

    @cached_property
    def more_staging(self) -> wp.array:
        """Return the same for reflectivity."""
        return wp.zeros(self._shape, dtype=wp.float32, device=self.out.device)

    @cached_property
    def normals(self) -> wp.array:
        """Return memory for the axial noise's normals of a pass, whole blocks of four."""
        size = self.count * self.blocks * 4
        return wp.zeros(size, dtype=wp.float32, device=self.out.device)

    @property
    def blocks(self) -> int:
        """Return how many blocks of four random numbers the pixels of a frame need."""
        return -(-self.height * self.width // 4)

    @property
    def surfaces(self) -> tuple[wp.array, wp.array]:
        """Return inverse depth and jumps of the environments at hand, with borders."""
        return self._p, self._jumps

    def grid(self, count: int) -> tuple[tuple[int, int, int], int]:
        """Return the threads for the pixels of some environments, and the pixels of each."""
        chunk = min(PIXELS_A_THREAD, self.width) if self.lists else self.width
        return (count, self.height, -(-self.width // chunk)), chunk

    def block_grid(self, count: int) -> tuple[tuple[int, int], int]:
        """Return the threads for random numbers of some environments, and the blocks of each."""
        chunk = 1 if self.lists else self.blocks
        return (count, self.blocks // chunk), chunk

    def list_grid(self, count: int) -> tuple[tuple[int, int], int]:
        """Return the threads for the listed pixels of some environments, and those of each."""
        return (count, THREADS_FOR_LISTED), THREADS_FOR_LISTED

    def find_surfaces(self, depth: wp.array, first: int, count: int) -> None:
        """
        Find surfaces and jumps.

        Parameters
        ----------
        depth : warp.array
            Flat float32 depth images.
        first, count : int
            Which of them.

        """
        grid, chunk = self.grid(count)
        launch(kernels.invert, grid, depth, self.lens, first, chunk, self._p, self.listed)
        surface = self._p, self.lens, chunk, self._jumps
        if self.lists:
            launch(kernels.list_jumps, grid, *surface, self.listed, self.pixel_list)
        else:
            launch(kernels.find_jumps, grid, *surface)

    def move_edges(self, first: int, count: int, rows: Rows) -> None:
        """Move the edges of environments, into `moved`."""
        random = rows.noise, rows.keys, rows.stamps, self.moved, self.listed, self.pixel_list
        if self.lists:
            grid, threads = self.list_grid(count)
            place = self._jumps, self.lens
            launch(edge_kernels.mark_edges, grid, *place, threads, self.listed, self.pixel_list)
            launch(edge_kernels.move_marked, grid, *place, first, threads, *random)
            return
        for column, lines in enumerate((self.height, self.width)):
            launch(
                edge_kernels.move_edges,
                (count, lines),
                self._jumps,
                self.lens,
                first,
                column,
                *random,
            )

    def draw_normals(self, first: int, count: int, rows: Rows) -> wp.array:
        """Return the axial noise's normals of some environments, in `normals`."""
        grid, chunk = self.block_grid(count)
        launch(
            observe_kernels.draw_normals,
            grid,
            self.height * self.width,
            first,
            chunk,
            rows.keys,
            rows.stamps,
            self.normals,
        )
        return self.normals

    def observe(self, first: int, count: int, rows: Rows, out: wp.array) -> None:
        """
        Write the frames of environments, after `find_surfaces` and `move_edges`.

        Parameters
        ----------
        first, count : int
            Which environments.
        rows : Rows
            Of all environments.
        out : warp.array
            (N * H * W,) float32, of all environments.

        """
        surface = (self._p, self._jumps, self.lens)
        if self.lists:
            launch(
                observe_kernels.observe_blocks,
                (count, (self.height * self.width + 3) // 4),
                *surface,
                first,
                rows.noise,
                rows.keys,
                rows.stamps,
                self.moved,
                out,
            )
        else:
            launch(
                observe_kernels.observe_rows,
                (count, self.height),
                *surface,
                first,
                rows.noise,
                self.draw_normals(first, count, rows),
                out,
            )
            launch(
                observe_kernels.observe_moved,
                count,
                *surface,
                first,
                rows.noise,
                rows.keys,
                rows.stamps,
                self.moved,
                self.listed,
                self.pixel_list,
                out,
            )

    def blank_outside(self, out: wp.array) -> None:
        """Blank all environments' (N * H * W,) float32 frames outside of the valid region."""
        self._blank(self._shape[0], self.lens.invalid, out)

    def blank_measured(self, count: int, measured: wp.array) -> None:
        """Do so with the measured depth of `count` environments, before filters mix neighbours."""
        self._blank(count, math.nan, measured)

    def _blank(self, count: int, invalid: float, out: wp.array) -> None:
        if self._outside is not None:
            threads = (count, self._outside.size)
            launch(region_kernels.blank_outside, threads, self._outside, invalid, out)


def launch(kernel: Any, threads: Any, *values: Any) -> None:
    """Launch a kernel on the current device."""
    wp.launch(kernel, threads, values)


def _lens(camera: Intrinsics, profile: Profile, invalid: float) -> Any:
    sensor = profile.sensor
    lens = kernels.Lens()
    lens.fx, lens.fy, lens.cx, lens.cy = camera.fx, camera.fy, camera.cx, camera.cy
    lens.height, lens.width = camera.height, camera.width
    lens.jump_share, lens.steep_share = sensor.jump_share, sensor.steep_share
    lens.cap = profile.modes[0].noise.incidence_cap
    lens.neighbourhood = sensor.neighbourhood_px
    lens.invalid = invalid
    return lens
