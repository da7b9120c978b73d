"""Which messages of two topics of a bag belong to one frame."""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

ABSENT = -1

_Place = tuple[int, int, int]


@dataclass
class Topic:
    """
    The messages of a topic: the first one, CDR, and the stamps of all and when they were received.

    Both are in nanoseconds.
    """

    first: bytes
    stamps: list[int]
    times: list[int]


def match(own: Topic, other: Topic) -> np.ndarray:
    """
    Find the message of another topic with the same stamp, for each message of a topic.

    A simulation that was reset gives the same stamps again. If stamps go back equally often in
    both topics, messages are of one frame if stamps went back equally often before them. Else one
    topic lacks a run, or has messages in another order. Of the messages with a stamp, those two
    then belong together that arrived nearest to each other.

    Both topics have at least a message. Returned is (T,) int64 for each message of `own`: the
    number of the other's, or `ABSENT`.
    """
    places, others = list(_places(own.stamps)), list(_places(other.stamps))
    if places[-1][0] == others[-1][0]:
        # Not by time: a bag that was converted may have one time for all frames after a reset.
        number_of = {place: number for number, place in enumerate(others)}
        return np.array([number_of.get(place, ABSENT) for place in places], np.int64)
    numbers = np.full(len(places), ABSENT, np.int64)
    candidates = _by_stamp(others, other.times)
    for stamp, mine in _by_stamp(places, own.times).items():
        theirs = candidates.get(stamp, [])
        for one, two in _nearest_pairs(
            [own.times[number] for number in mine], [other.times[number] for number in theirs]
        ):
            numbers[mine[one]] = theirs[two]
    return numbers


def _places(stamps: list[int]) -> Iterator[_Place]:
    # How often stamps have gone back so far, the stamp, and how many of the same there were just
    # before.
    passes, repeats, last = 0, 0, stamps[0] - 1
    for stamp in stamps:
        passes += stamp < last
        repeats = repeats + 1 if stamp == last else 0
        last = stamp
        yield passes, stamp, repeats


def _by_stamp(places: list[_Place], times: list[int]) -> dict[tuple[int, int], list[int]]:
    # The numbers of the messages of each stamp and repeat, in the order in which they arrived.
    found: dict[tuple[int, int], list[int]] = {}
    for number in sorted(range(len(times)), key=times.__getitem__):
        _, stamp, repeats = places[number]
        found.setdefault((stamp, repeats), []).append(number)
    return found


def _nearest_pairs(times: list[int], others: list[int]) -> Iterator[tuple[int, int]]:
    # Only pairs of which each is the nearest to the other: a message of a run that the other
    # topic lacks stays alone.
    for number, time in enumerate(times):
        nearest = _nearest(time, others)
        if nearest is not None and _nearest(others[nearest], times) == number:
            yield number, nearest


def _nearest(time: int, others: list[int]) -> int | None:
    # The number of the nearest of sorted times.
    after = bisect_left(others, time)
    return min(
        range(max(after - 1, 0), min(after + 1, len(others))),
        key=lambda number: abs(others[number] - time),
        default=None,
    )
