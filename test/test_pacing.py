"""Ticks against the clock: exact stamps at any pace, catching up, and giving up."""

from flexx2_sim_ros.nodes import timing
from flexx2_sim_ros.nodes.timing import Pacer
import pytest


@pytest.fixture
def clock(monkeypatch):
    """Return a clock to be set by hand: ``clock[0]`` is now."""
    now = [100.0]
    monkeypatch.setattr(timing.time, 'monotonic', lambda: now[0])
    return now


@pytest.mark.parametrize('factor', [0.1, 1.0, 7.3])
@pytest.mark.parametrize('rate', [30.0, 59.94, 60.0])
def test_ticks_keep_pace_and_their_stamps_are_exact(clock, rate, factor):
    pacer = Pacer(rate)
    pacer.restart(factor)
    assert pacer.period == pytest.approx(1 / (rate * factor), rel=1e-9)
    stamps = []
    for _ in range(2000):
        clock[0] += 0.37 * pacer.period
        for _ in range(pacer.due()):
            pacer.tick += 1
            stamps.append(pacer.stamp)
    assert pacer.tick == pytest.approx(740, abs=2)
    assert stamps == [k * 10**12 // round(rate * 1000) for k in range(1, pacer.tick + 1)]
    assert pacer.lag == 0.0


def test_late_ticks_are_caught_up_and_very_late_ones_dropped(clock):
    pacer = Pacer(60.0)
    clock[0] += 0.101
    made = []
    while due := pacer.due():
        pacer.tick += due
        made.append(due)
    assert made == [2, 2, 2]
    assert pacer.lag == 0.0
    clock[0] += 10.0
    assert pacer.due() == 1
    assert pacer.lag == pytest.approx(10.0, abs=0.03)
    pacer.tick += 1
    assert pacer.due() == 0
    clock[0] += 0.018
    pacer.restart(2.0)
    assert pacer.due() == 0
    clock[0] += 0.0084
    assert pacer.due() == 1
