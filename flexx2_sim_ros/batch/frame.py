"""
What kernels read and write, and kernels that do something in each pixel of a frame.

Images are flat: frame after frame, row after row. Inverse depth (0 without a return) and jumps
have a border of `PAD` zeros on each side, so that no pixel needs a case of its own. A thread
takes ``chunk`` pixels of a row: all of them on the CPU, where the loop becomes vector
instructions, a few on CUDA.
"""

from collections.abc import Callable
from typing import Any

from flexx2_sim_ros.batch.arrays import end_of, first_of, stride_of
from flexx2_sim_ros.batch.effect_tables import Effects, Light
from flexx2_sim_ros.physics import surface
import warp as wp

# What physics.philox.FAST allows there: all but assuming that there is no NaN and no infinity.
OPTIONS = {
    'enable_backward': False,
    'fast_math': True,
    'default_grid_stride': False,  # on CUDA
    'cpu_compiler_flags': f'{wp.config.cpu_compiler_flags or "-march=native"} -ffp-contract=fast '
    '-mreassociate -freciprocal-math -fno-signed-zeros -fapprox-func',
}
wp.set_module_options(OPTIONS)

PAD = wp.constant(surface.PAD)
BORDER = wp.constant(2 * surface.PAD)
# Counters are so far apart that those of two environments are not in one line of a cache.
SPREAD = wp.constant(32)
YES = wp.constant(wp.uint8(1))
NO = wp.constant(wp.uint8(0))


@wp.struct
class Lens:
    """What is the same for all environments: the camera matrix and the model's constants."""

    fx: wp.float32
    fy: wp.float32
    cx: wp.float32
    cy: wp.float32
    height: wp.int32
    width: wp.int32
    jump_share: wp.float32
    steep_share: wp.float32
    cap: wp.float32
    neighbourhood: wp.int32
    invalid: wp.float32


@wp.struct
class Noise:
    """What depends on an environment's mode."""

    a: wp.float32
    b: wp.float32
    c: wp.float32
    d: wp.float32
    n: wp.float32
    range_min: wp.float32
    range_max: wp.float32
    edge_sigma: wp.float32
    edge_laplace: wp.float32
    edge_limit: wp.int32


@wp.struct
class Surfaces:
    """What the environments of the pass look at; small, for functions that are called often."""

    lens: Lens
    p: wp.array(dtype=wp.float32)  # inverse depth, with a border
    jumps: wp.array(dtype=wp.uint8)  # with a border
    reflectivity: wp.array(dtype=wp.float32)  # empty: 1 everywhere
    first_of_reflectivity: wp.int32


@wp.struct
class Motion:
    """The frame before of every environment, and how each pixel of a pass moves."""

    depth: wp.array(dtype=wp.float32)  # of every environment: metres; NaN without a return
    reflectivity: wp.array(dtype=wp.float32)  # of every environment
    late: wp.array(dtype=wp.float32)  # of the pass: depth and
    late_reflectivity: wp.array(dtype=wp.float32)  # reflectivity now,
    across: wp.array(dtype=wp.float32)  # 1 at an edge to the pixel on the left,
    down: wp.array(dtype=wp.float32)  # or above
    start: wp.array(dtype=wp.float32)  # depth before less depth now
    gain: wp.array(dtype=wp.float32)  # light before over that now
    other: wp.array(dtype=wp.float32)  # depth across the edge that passes, metres,
    light: wp.array(dtype=wp.float32)  # light there over that here,
    when: wp.array(dtype=wp.float32)  # and when it passes; 1: never


@wp.struct
class Bounce:
    """What is kept of environments with indirect light: arrays of images, one for each."""

    places: wp.array(dtype=wp.int32)  # of each environment in the arrays below; -1 for none
    changed: wp.array(dtype=wp.uint8)  # 1: a patch is not what it was in the frame before
    senders: wp.array(dtype=wp.float32)  # `patch`, one field of all patches after the other
    receivers: wp.array(dtype=wp.float32)
    indirect: wp.array(dtype=wp.float32)  # by frequency, of receivers: real, then imaginary
    wide: wp.array(dtype=wp.float32)  # of the pass, see `widen`: depth, then as `indirect`
    fields: wp.int32  # in `wide`, left and right each
    sender_count: wp.int32
    receiver_count: wp.int32
    frequencies: wp.int32  # that there is room for


@wp.struct
class Scatter:
    """How light spreads, and the images of a pass: all real parts, then all imaginary ones."""

    kinds: wp.array(dtype=wp.int32)  # of each environment, which kernel; -1 for none
    across: wp.array(dtype=wp.float32)  # by kernel and term: for -(columns - 1)..columns - 1
    down: wp.array(dtype=wp.float32)  # by kernel and term: for -(rows - 1)..rows - 1
    terms: wp.int32
    rows: wp.int32
    columns: wp.int32
    envs: wp.int32  # in a pass
    size: wp.int32  # blocks of a pass
    directions: wp.array(dtype=wp.float32)  # the phase of each pixel
    blocks: wp.array(dtype=wp.float32)  # light by block
    spread: wp.array(dtype=wp.float32)  # by block column, term and block row
    scattered: wp.array(dtype=wp.float32)  # by block
    wide: wp.array(dtype=wp.float32)  # the same between blocks, for each pixel of a block row


@wp.struct
class Frame:
    """
    A frame in the making; arrays for effects that no environment has are empty.

    Kernels on CUDA take at most 4096 bytes, 56 for each array.
    """

    lens: Lens
    surfaces: Surfaces
    first: wp.int32  # environment of the pass
    chunk: wp.int32  # pixels of a thread
    threads: wp.int32  # of an environment, for listed pixels
    frequency: wp.int32  # at hand, of stray_light, which takes one after the other
    # Of every environment, see `images.Rows`:
    noises: wp.array(dtype=Noise)
    effects: wp.array(dtype=Effects)
    lights: wp.array(dtype=Light)
    surface_noise: wp.array(dtype=wp.vec3f)
    keys: wp.array(dtype=wp.vec2ui)
    stamps: wp.array(dtype=wp.int64)
    is_due: wp.array(dtype=wp.uint8)
    was_reset: wp.array(dtype=wp.uint8)
    is_first: wp.array(dtype=wp.uint8)
    started: wp.array(dtype=wp.int64)
    last: wp.array(dtype=wp.int64)
    before: wp.array(dtype=wp.int64)
    kept: wp.array(dtype=wp.float32)  # the frame before, for temporal_filter
    grain: wp.array(dtype=wp.float32)  # for fixed_pattern
    out: wp.array(dtype=wp.float32)  # finished frames
    # Of the environments of the pass, at each pixel's own surface:
    facing: wp.array(dtype=wp.float32)  # cosine of incidence
    expected: wp.array(dtype=wp.float32)  # sigma_z
    amplitude: wp.array(dtype=wp.float32)
    total: wp.array(dtype=wp.float32)  # sum over the frequencies so far, of what becomes amplitude
    shifts: wp.array(dtype=wp.float32)  # of each frequency, one image after the other
    pitch: wp.int32  # pixels of the pass
    # Which pixels see another surface, and random numbers; see `images.Images`:
    moved: wp.array(dtype=wp.uint16)
    listed: wp.array(dtype=wp.int32)
    pixel_list: wp.array(dtype=wp.int32)
    normals: wp.array(dtype=wp.float32)  # whole blocks of four
    chances: wp.array(dtype=wp.float32)  # uniform numbers; whole blocks of four
    # As each pixel sees it, after edges have moved:
    measured: wp.array(dtype=wp.float32)
    filtered: wp.array(dtype=wp.float32)
    sigma: wp.array(dtype=wp.float32)
    cosine: wp.array(dtype=wp.float32)
    signal: wp.array(dtype=wp.float32)
    depth: wp.array(dtype=wp.float32)
    # What single effects need:
    motion: Motion
    bounce: Bounce
    scatter: Scatter


@wp.struct
class Own:
    """What is an environment's own."""

    env: wp.int32
    noise: Noise
    effects: Effects
    light: Light
    turns: wp.float32  # `light.turns` of the frequency at hand
    weight: wp.float32
    surface_noise: wp.vec3f
    key: wp.vec2ui
    stamp: wp.int64
    is_due: wp.bool  # a frame is taken now
    is_first: wp.bool
    elapsed: wp.int64  # nanoseconds since the first frame
    interval: wp.int64  # and since the frame before


@wp.func
def own_of(f: Frame, n: wp.int32) -> Own:
    """Return what belongs to environment ``n`` of the pass."""
    own = Own()
    own.env = f.first + n
    own.noise = f.noises[own.env]
    own.effects = f.effects[own.env]
    own.light = f.lights[own.env]
    own.turns = own.light.turns[f.frequency]
    own.weight = own.light.weights[f.frequency]
    own.key = f.keys[own.env]
    own.surface_noise = f.surface_noise[own.env]
    own.stamp = f.stamps[own.env]
    own.is_due = f.is_due[own.env] == YES
    own.is_first = f.is_first[own.env] == YES
    own.elapsed = f.last[own.env] - f.started[own.env]
    own.interval = f.last[own.env] - f.before[own.env]
    return own


@wp.func
def always(f: Frame, own: Own) -> wp.bool:
    """Return that the environment needs a kernel."""
    return True


def _maker(kernel_of: Callable[[Any, Any], Any]) -> Callable[..., Callable[[Any], Any]]:
    # A decorator that makes a kernel of what a function does in a pixel, in the function's own
    # module, which is compiled when it is needed. `when`, of `Frame` and `Own`, says whether the
    # environment needs it; `options` are those of `warp.kernel`.
    def of(when: Any = always, **options: Any) -> Callable[[Any], Any]:
        def decorate(body: Any) -> Any:
            kernel = kernel_of(wp.func(body), when)
            kernel.__name__, kernel.__qualname__ = body.__name__, f'{body.__qualname__}_everywhere'
            kernel.__doc__ = body.__doc__
            return wp.kernel(kernel, module=wp.get_module(body.__module__), **options)

        return decorate

    of.__doc__ = kernel_of.__doc__
    return of


@_maker
def of_pixels(in_pixel: Any, when: Any) -> Any:
    """Make a kernel of a function of `Frame`, `Own`, environment of the pass, row and column."""

    def kernel(f: Frame):
        n, y, c = wp.tid()
        own = own_of(f, n)
        if when(f, own):
            x = first_of(c, f.chunk)
            end = end_of(c, f.chunk, f.lens.width)
            stride = stride_of(f.lens.width)
            while x < end:
                in_pixel(f, own, n, y, x)
                x += stride

    return kernel


@_maker
def of_frequencies(in_pixel: Any, when: Any) -> Any:
    """Make a kernel as `of_pixels`, of a function that takes a frequency after `Own`."""

    def kernel(f: Frame):
        n, y, c = wp.tid()
        own = own_of(f, n)
        if when(f, own):
            end = end_of(c, f.chunk, f.lens.width)
            stride = stride_of(f.lens.width)
            k = wp.int32(0)
            while k < own.light.frequencies:
                own.turns = own.light.turns[k]
                own.weight = own.light.weights[k]
                x = first_of(c, f.chunk)
                while x < end:
                    in_pixel(f, own, k, n, y, x)
                    x += stride
                k += 1

    return kernel


@_maker
def of_listed(in_pixel: Any, when: Any) -> Any:
    """Make a kernel as `of_pixels`, for the listed pixels alone."""

    def kernel(f: Frame):
        n, thread = wp.tid()
        own = own_of(f, n)
        if when(f, own):
            entry = wp.int32(thread)
            while entry < f.listed[n * SPREAD]:
                pixel = f.pixel_list[n * f.lens.height * f.lens.width + entry]
                y = pixel / f.lens.width
                in_pixel(f, own, n, y, pixel - y * f.lens.width)
                entry += f.threads

    return kernel


@wp.func
def padded(lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.int32:
    """Return where a pixel is in an image with a border."""
    return (n * (lens.height + BORDER) + y + PAD) * (lens.width + BORDER) + x + PAD


@wp.func
def place(lens: Lens, n: wp.int32, y: wp.int32, x: wp.int32) -> wp.int32:
    """Return where a pixel is in an image without a border."""
    return (n * lens.height + y) * lens.width + x


@wp.func
def blocks_of(pixels: wp.int32) -> wp.int32:
    """Return how many counters the pixels of a frame need."""
    return (pixels + 3) / 4
