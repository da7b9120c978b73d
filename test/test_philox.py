"""The counter-based generator: the published vectors, a plain reference, and its statistics."""

import math

from flexx2_sim_ros.physics.philox import (
    camera_key,
    fill_normals,
    fill_uniforms,
    normal_pair,
    philox4x32,
    stamp_words,
    STREAM_AXIAL,
    STREAM_COLUMN_EDGES,
)
import numpy as np
import pytest

MANY = 1_000_000

# Random123's known-answer file, philox4x32 with 10 rounds: counter, key, answer.
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


def reference_philox(counter, key):
    """Run ten rounds on arrays of uint64 that hold 32-bit words."""
    word = np.uint64(0xFFFFFFFF)
    half = np.uint64(32)
    c0, c1, c2, c3 = counter
    k0, k1 = (int(part) for part in key)
    for _ in range(10):
        low, high = np.uint64(0xD2511F53) * c0, np.uint64(0xCD9E8D57) * c2
        c0, c1, c2, c3 = (
            (high >> half) ^ c1 ^ np.uint64(k0),
            high & word,
            (low >> half) ^ c3 ^ np.uint64(k1),
            low & word,
        )
        k0, k1 = (k0 + 0x9E3779B9) & 0xFFFFFFFF, (k1 + 0xBB67AE85) & 0xFFFFFFFF
    return [c0, c1, c2, c3]


def reference_normals(key, stamp_ns, stream, size):
    """Draw what `fill_normals` must, in float64."""
    blocks = np.arange(-(-size // 4), dtype=np.uint64)
    stamp = stamp_ns & 0xFFFFFFFF, (stamp_ns >> 32) & 0xFFFFFFFF
    words = [np.full_like(blocks, value) for value in (stream, *stamp)]
    drawn = reference_philox([blocks, *words], (key[0], key[1]))
    u = [c.astype(np.float32).astype(np.float64) for c in drawn]
    out = np.empty((blocks.size, 4))
    for i in (0, 2):
        radius = np.sqrt(-2 * np.log(np.minimum((u[i] + 0.5) * 2.0**-32, 1)))
        angle = 2 * math.pi * u[i + 1] * 2.0**-32
        out[:, i], out[:, i + 1] = radius * np.cos(angle), radius * np.sin(angle)
    return out.ravel()[:size]


def normals(size=MANY, *, seed=5, name='left', stamp_ns=0, stream=STREAM_AXIAL):
    """Draw from the package."""
    out = np.full(size, np.nan, np.float32)
    fill_normals(camera_key(seed, name), *stamp_words(stamp_ns), stream, out)
    return out


@pytest.mark.parametrize(('counter', 'key', 'answer'), KNOWN)
def test_known_answers(counter, key, answer):
    words = [np.uint32(word) for word in (*counter, *key)]
    assert tuple(int(word) for word in philox4x32(*words)) == answer
    arrays = [np.array([word], np.uint64) for word in counter]
    assert tuple(int(word[0]) for word in reference_philox(arrays, key)) == answer


@pytest.mark.parametrize('stamp_ns', [0, -1, 1_700_000_000_123_456_789, 2**63 - 1, -(2**63)])
@pytest.mark.parametrize('size', [0, 1, 5, 1001])
def test_random_numbers_agree_with_the_reference_in_every_pixel(size, stamp_ns):
    for stream in (STREAM_AXIAL, STREAM_COLUMN_EDGES):
        drawn = normals(size, stamp_ns=stamp_ns, stream=stream)
        wanted = reference_normals(camera_key(5, 'left'), stamp_ns, stream, size)
        np.testing.assert_allclose(drawn, wanted, rtol=0, atol=1e-5)


@pytest.mark.parametrize('fill', [fill_normals, fill_uniforms])
def test_any_number_of_pixels_is_filled_and_nothing_behind_them(fill):
    key, low, high = camera_key(3, 'front'), *stamp_words(7)
    many = np.empty(12, np.float32)
    fill(key, low, high, STREAM_AXIAL, many)
    for size in range(1, 10):
        held = np.full(size + 4, np.nan, np.float32)
        fill(key, low, high, STREAM_AXIAL, held[:size])
        np.testing.assert_array_equal(held[:size], many[:size])
        assert np.isnan(held[size:]).all()


def test_extreme_words_give_finite_normals():
    words = [0, 1, 2**31, 2**32 - 257, 2**32 - 129, 2**32 - 128, 2**32 - 1]
    pairs = [normal_pair(np.uint32(a), np.uint32(b)) for a in words for b in words]
    assert np.isfinite(pairs).all()
    assert 6.7 < np.abs(pairs).max() < 6.8


def test_distribution_is_normal():
    """Assert by Kolmogorov and Smirnov; false failure 2 exp(-2 * 3^2) = 3e-8."""
    drawn = np.sort(normals(200_000).astype(np.float64))
    cdf = np.array([0.5 * math.erfc(-value / math.sqrt(2)) for value in drawn])
    steps = np.arange(drawn.size + 1) / drawn.size
    distance = max((steps[1:] - cdf).max(), (cdf - steps[:-1]).max())
    assert distance * math.sqrt(drawn.size) < 3.0


def test_keys_cannot_be_confused():
    pairs = [(seed, name) for seed in (0, 1, 10, -1) for name in ('', '0', '/0', '1/', 'é', 'a b')]
    keys = {camera_key(seed, name).tobytes() for seed, name in pairs}
    assert len(keys) == len(pairs)
    assert camera_key(0, '').dtype == np.uint32
    np.testing.assert_array_equal(camera_key(3, 'left'), camera_key(3, 'left'))
