"""Pair a depth image with the messages that have the same stamp."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

_KEPT = 16


@dataclass(frozen=True)
class Match:
    """
    A depth image, its stamp in nanoseconds, and its companions: messages or None.

    ``info`` is the one of the image's stamp, else the latest, else None; ``reflectivity`` is of
    exactly the image's stamp.
    """

    stamp: int
    image: Any
    info: Any
    reflectivity: Any


class StampPairing:
    """
    Pair depth images with camera infos and reflectivity images by stamp.

    Messages of one stamp arrive on their topics in any order. An image waits for a companion only
    if the image before had one, and at most until the next image. So a companion that is no
    longer published does not stop the stream, and a latched camera info delays one frame once. A
    camera info that comes again with the same stamp delays none.
    When stamps go back (a simulation was reset), messages from before are not paired with
    messages from after, except for the last camera info.

    By name of companion, ``paired`` counts images with this companion, and ``unpaired`` the
    companions that were dropped because no image had their stamp.
    """

    def __init__(self) -> None:
        """Start without messages: the first image waits for a camera info only."""
        self._expected = {'info': True, 'reflectivity': False}
        self._kept: dict[str, OrderedDict[int, Any]] = {
            name: OrderedDict() for name in self._expected
        }
        self._unused: dict[str, set[int]] = {name: set() for name in self._expected}
        self.paired = dict.fromkeys(self._expected, 0)
        self.unpaired = dict.fromkeys(self._expected, 0)
        # Companions whose stamps went back before the image's did.
        self._gone_back: set[str] = set()
        self._pending: tuple[int, Any] | None = None
        self._released: int | None = None
        self._newest = -(1 << 63)
        self._last_info: Any = None

    def image(self, stamp: int, message: Any) -> list[Match]:
        """Add an image; return the matches that are now complete, in order."""
        matches = []
        if self._pending is not None:
            for name in self._missing(self._pending[0]):
                self._expected[name] = False
            matches.append(self._release())
        if stamp < self._newest:
            for name, kept in self._kept.items():
                if name not in self._gone_back and kept and next(reversed(kept)) > stamp:
                    self._forget(name)
            self._gone_back.clear()
        self._newest = stamp
        self._pending = (stamp, message)
        if not self._missing(stamp):
            matches.append(self._release())
        return matches

    def companion(self, name: str, stamp: int, message: Any) -> list[Match]:
        """Add an ``info`` or ``reflectivity``; return the matches that are now complete."""
        if name == 'info':
            self._last_info = message
        kept = self._kept[name]
        if kept and stamp < next(reversed(kept)):
            self._forget(name)
            self._gone_back.add(name)
        repeated = stamp in kept
        kept[stamp] = message
        kept.move_to_end(stamp)
        self._unused[name].add(stamp)
        while len(kept) > _KEPT:
            dropped, _ = kept.popitem(last=False)
            self._drop(name, {dropped})
        pending = None if self._pending is None else self._pending[0]
        if stamp == pending or (stamp == self._released and not repeated):
            self._expected[name] = True
        elif repeated and name == 'info':
            # Camera infos that keep one stamp are those of all images.
            self._expected[name] = False
        if pending is not None and not self._missing(pending):
            return [self._release()]
        return []

    def _missing(self, stamp: int) -> list[str]:
        return [
            name
            for name, expected in self._expected.items()
            if expected and stamp not in self._kept[name]
        ]

    def _forget(self, name: str) -> None:
        self._kept[name].clear()
        self._drop(name, set(self._unused[name]))

    def _drop(self, name: str, stamps: set[int]) -> None:
        self.unpaired[name] += len(stamps & self._unused[name])
        self._unused[name] -= stamps

    def _release(self) -> Match:
        assert self._pending is not None
        stamp, image = self._pending
        for name, kept in self._kept.items():
            if stamp in kept:
                self.paired[name] += 1
                self._unused[name].discard(stamp)
        self._pending = None
        self._released = stamp
        return Match(
            stamp,
            image,
            self._kept['info'].get(stamp, self._last_info),
            self._kept['reflectivity'].get(stamp),
        )
