"""Frame timing by stamps: the mode's rate, exactly, from whatever comes in."""

from itertools import pairwise
import math

from flexx2_sim_ros.nodes.pacing import FrameGate
from flexx2_sim_ros.profiles.modes import flexx2
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
RATES = sorted({mode.rate_hz for mode in flexx2().modes})
STAMPS = st.integers(-(2**31) * SECOND, 2**31 * SECOND)


def clock(hz, seconds, *, jitter=0.0, start=START):
    """Return stamps of an input; ``jitter`` is a share of its period, either way."""
    random = np.random.default_rng(int(hz * 1000))
    count = int(hz * seconds)
    moved = random.uniform(-jitter, jitter, count) * SECOND / hz
    rounding = random.integers(-1, 2, count)
    return [start + round(i * SECOND / hz + moved[i]) + int(rounding[i]) for i in range(count)]


def accepted(gate, stamps):
    """Return the stamps that become frames."""
    return [stamp for stamp in stamps if gate.accept(stamp)]


@pytest.mark.parametrize(
    ('input_hz', 'jitter'),
    [*((hz, 0.0) for hz in (7, 29.97, 60, 60.02, 75, 240, 1000)), (29.97, 0.1), (75, 0.1)],
)
@pytest.mark.parametrize('rate', RATES)
def test_rate_is_exact_in_the_long_run(rate, input_hz, jitter):
    """Assert the lower of both rates to 0.5 %, and no frame far from its due time."""
    stamps = clock(input_hz, 60 if input_hz < 500 else 10, jitter=jitter)
    frames = accepted(FrameGate(rate), stamps)
    measured = (len(frames) - 1) * SECOND / (frames[-1] - frames[0])
    assert measured == pytest.approx(min(rate, input_hz), rel=0.005)
    if input_hz > rate:
        off = [frame - START - k * SECOND / rate for k, frame in enumerate(frames)]
        # The first frame sets the beat, and with it both may be off by the jitter.
        slack = 2 * jitter * SECOND / input_hz + 4
        # The next few may come earlier: how fast the input is, is not known yet.
        early = 0.45 / input_hz if input_hz > 1.1 * rate else 0.67 / rate
        assert min(off[6:]) >= -early * SECOND - slack
        assert max(off) <= SECOND / input_hz + slack


@given(st.integers(0, 2**32 - 1), st.sampled_from(RATES), st.floats(0.9, 1.0), st.booleans())
def test_jitter_up_to_a_third_loses_nothing(seed, rate, slower, extreme):
    random = np.random.default_rng(seed)
    off = random.choice([-1, 1], 300) if extreme else random.uniform(-1, 1, 300)
    period = SECOND / rate / slower
    lost = random.uniform(size=300) < 0.05
    stamps = np.rint((np.arange(300) + off / 3) * period).astype(int)[~lost].tolist()
    gate = FrameGate(rate)
    assert accepted(gate, stamps) == stamps
    gate.set_rate(rate / 3)
    accepted(gate, [stamp + stamps[-1] + SECOND for stamp in stamps])
    gate.set_rate(rate)
    again = [stamp + 3 * stamps[-1] for stamp in stamps]
    assert accepted(gate, again) == again


@pytest.mark.parametrize('jitter', [0, 0.05])
@pytest.mark.parametrize(
    ('input_hz', 'rate'), [(60, 45), (50, 45), (75, 60), (60, 30), (60, 5), (240, 45)]
)
def test_periods_are_as_even_as_the_input_allows(input_hz, rate, jitter):
    """Assert neighbouring numbers of inputs a frame, evenly mixed, at once after a switch."""
    stamps = clock(input_hz, 20, jitter=jitter)
    half = len(stamps) // 2
    gate = FrameGate(60.0)
    before = accepted(gate, stamps[:half])
    gate.set_rate(rate)
    frames = np.searchsorted(stamps, [before[-1], *accepted(gate, stamps[half:])])
    exact = np.arange(len(frames)) * input_hz / rate
    off = frames - frames[0] - exact
    assert set(np.diff(frames)) <= {math.floor(input_hz / rate), math.ceil(input_hz / rate)}
    assert np.ptp(off) <= 1.01 + 2 * jitter, off


@pytest.mark.parametrize('rate', RATES)
def test_no_drift_in_ten_hours(rate):
    gate = FrameGate(rate)
    assert gate.accept(START)
    hours = 10 * 3600 * SECOND
    for k in range(int(rate)):
        assert gate.accept(START + hours + round(k * SECOND / rate))


def test_repeats_and_restarts():
    gate = FrameGate(30.0)
    stamps = clock(60, 1)
    first = accepted(gate, stamps)
    assert not gate.accept(stamps[-1])
    assert (gate.repeats, gate.restarts) == (1, 0)
    again = accepted(gate, [stamp - 100 * SECOND for stamp in stamps])
    # Only after the first start, the gate did not know yet how fast the input is.
    assert [stamp + 100 * SECOND for stamp in again[2:]] == first[2:]
    assert again[:2] == [stamp - 100 * SECOND for stamp in stamps[:3:2]]
    assert (gate.repeats, gate.restarts) == (1, 1)


def test_a_gap_is_followed_by_the_next_image():
    gate = FrameGate(60.0)
    accepted(gate, clock(60, 1))
    for gap in (SECOND, 3600 * SECOND, 10**17):
        later = clock(60, 1, start=START + gap + SECOND)
        frames = accepted(gate, later)
        assert frames[0] == later[0]
        assert len(frames) >= 59


@given(st.lists(STAMPS, max_size=40), st.sampled_from(RATES))
def test_any_stamps_are_counted_once(stamps, rate):
    gate = FrameGate(rate)
    frames = accepted(gate, stamps)
    assert len(frames) + gate.early + gate.repeats == len(stamps)
    assert gate.restarts == sum(later < sooner for sooner, later in pairwise(stamps))
    if not gate.restarts:
        assert all(later > sooner for sooner, later in pairwise(frames))
        if len(frames) > 1:
            span = frames[-1] - frames[0]
            assert len(frames) - 1 <= span * rate / SECOND + 0.67 + 1e-6
