"""
Element access for loops that the CPU compiler turns into vector instructions.

Warp's own ``a[i]`` takes negative indices and any stride, which keeps loops over it scalar on
the CPU (eight times slower, measured). These take contiguous one-dimensional arrays and indices
from 0. In Warp's debug mode both check their bounds.

A thread's pixels of a row are ``first_of``, and every ``stride_of`` from there to ``end_of``: one
after the other on the CPU; on CUDA as many apart as the row has threads, so that neighbouring
threads read neighbouring memory.
"""

from typing import Any

import warp as wp

PIXELS_A_THREAD = 4  # on CUDA, as many as share a counter of random numbers


def _getter(kind: Any) -> Any:
    @wp.func_native('assert(i >= 0 && i < a.shape[0]); return a.data[i];')
    def at(a: wp.array(dtype=kind), i: wp.int32) -> kind: ...

    return at


def _putter(kind: Any) -> Any:
    @wp.func_native('assert(i >= 0 && i < a.shape[0]); a.data[i] = v;')
    def put(a: wp.array(dtype=kind), i: wp.int32, v: kind) -> None: ...

    return put


at, at_byte, at_word = map(_getter, (wp.float32, wp.uint8, wp.uint16))
put, put_byte, put_word = map(_putter, (wp.float32, wp.uint8, wp.uint16))


def _where(on_cuda: str, on_cpu: str) -> str:
    return f'\n#ifdef __CUDA_ARCH__\n{on_cuda}\n#else\n{on_cpu}\n#endif\n'


@wp.func_native(_where('return c;', 'return c * chunk;'))
def first_of(c: wp.int32, chunk: wp.int32) -> wp.int32:
    """Return the first pixel of thread ``c`` of a row."""
    ...


@wp.func_native(
    _where('return width;', 'int end = c * chunk + chunk; return end < width ? end : width;')
)
def end_of(c: wp.int32, chunk: wp.int32, width: wp.int32) -> wp.int32:
    """Return where the pixels of thread ``c`` of a row end."""
    ...


@wp.func_native(
    _where(f'return (width + {PIXELS_A_THREAD - 1}) / {PIXELS_A_THREAD};', 'return 1;')
)
def stride_of(width: wp.int32) -> wp.int32:
    """Return how far apart the pixels of a thread are."""
    ...


@wp.func_native(
    'unsigned short *place = moved.data + i, before = *place;'
    + _where(
        'while (before == 0 || code < before) {'
        ' unsigned short found = atomicCAS(place, before, code);'
        ' if (found == before) break;'
        ' before = found; }',
        'if (before == 0 || code < before) *place = code;',
    )
    + 'return before;'
)
def put_least(moved: wp.array(dtype=wp.uint16), i: wp.int32, code: wp.uint16) -> wp.uint16:
    """Write ``code`` where there is 0 or more than it, and return what was there."""
    ...


_ADD_EACH = """
const unsigned mates = __match_any_sync(__activemask(), i), lane = threadIdx.x & 31;
unsigned before = 0, all = 0;
for (int bit = 0; bit < 3; ++bit) {
    const unsigned some = __ballot_sync(mates, count >> bit & 1) & mates;
    before += __popc(some & ((1u << lane) - 1)) << bit;
    all += __popc(some) << bit;
}
const int leader = __ffs(mates) - 1;
int place = 0;
if (lane == leader && all > 0) place = atomicAdd(counts.data + i, (int)all);
return __shfl_sync(mates, place, leader) + (int)before;
"""


@wp.func_native(
    _where(_ADD_EACH, 'int place = counts.data[i]; counts.data[i] += count; return place;')
)
def add_each(counts: wp.array(dtype=wp.int32), i: wp.int32, count: wp.int32) -> wp.int32:
    """
    Add 0 to 7 to an element, and return what was there without this and later threads' numbers.

    On CUDA once for all threads of a warp: many threads that add to one element wait in line.
    """
    ...


@wp.func_native(_where('return true;', 'return false;'))
def on_cuda() -> wp.bool:
    """Say whether this is code for a GPU."""
    ...


def _on_cuda_only(code: str) -> Any:
    @wp.func_native(_where(code, 'return 0.0f;'))
    def quick(x: wp.float32) -> wp.float32: ...

    return quick


quick_exp2 = _on_cuda_only('return exp2f(x);')
quick_log2 = _on_cuda_only('return __log2f(x);')
# Of an angle in turns:
quick_cosine = _on_cuda_only('return __cosf(6.2831853f * (x - rintf(x)));')
quick_sine = _on_cuda_only('return __sinf(6.2831853f * (x - rintf(x)));')
