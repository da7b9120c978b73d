"""Problems of a camera node's input, for the log and the diagnostics."""

from collections.abc import Mapping
from dataclasses import dataclass
import time

from flexx2_sim_ros.nodes.pairing import StampPairing
from flexx2_sim_ros.nodes.plausibility import explain, sees_something
from flexx2_sim_ros.nodes.subscriptions import Input
from flexx2_sim_ros.profiles.modes import Mode
import numpy as np

# How long a loss is reported.
_LATELY_SECONDS = 5.0


@dataclass(frozen=True)
class Remark:
    """
    A remark about the input, for users; `warn` says whether they should act on it.

    ``kind`` identifies the reason; independent of values in the text.
    """

    kind: str
    text: str
    warn: bool = True


class InputWatch:
    """
    Watch the input for lost messages, unpaired messages and images without a pixel in range.

    ``inputs`` are by name (``clean/depth_image``).
    """

    def __init__(self, inputs: Mapping[str, Input], pairing: StampPairing) -> None:
        """Start without remarks."""
        self._inputs, self._pairing = inputs, pairing
        self._image: tuple[np.ndarray, str, Mode] | None = None
        self._lost = dict.fromkeys(inputs, 0)
        self._lost_at = dict.fromkeys(inputs, float('-inf'))
        self._paired = (0, 0)

    def keep(self, depth: np.ndarray, encoding: str, mode: Mode) -> None:
        """Keep a decoded depth image (H, W) in metres; the next `remarks` checks the last one."""
        self._image = depth, encoding, mode

    def remarks(self) -> list[Remark]:
        """Return the present remarks, the most important first."""
        return [*self._losses(), *self._invisible(), *self._unpaired()]

    def values(self) -> dict[str, str]:
        """Return counters for the diagnostics."""
        values = {
            f'messages lost ({name})': str(source.lost) for name, source in self._inputs.items()
        }
        values['reflectivity without a depth image of its stamp'] = str(
            self._pairing.unpaired['reflectivity']
        )
        return values

    def publishers(self, name: str) -> int:
        """Return how many publishers an input has."""
        return self._inputs[name].publishers

    def _losses(self) -> list[Remark]:
        now, remarks = time.monotonic(), []
        for name, source in self._inputs.items():
            lost = source.lost
            if lost > self._lost[name]:
                self._lost[name], self._lost_at[name] = lost, now
            if now - self._lost_at[name] < _LATELY_SECONDS:
                remarks.append(
                    Remark(
                        f'{name} lost',
                        f'{name}: messages are lost on the way here, or come faster '
                        f'than this node takes them ({lost} so far): start the publisher with '
                        "more shared memory (FASTRTPS_DEFAULT_PROFILES_FILE=this package's config/"
                        'fastdds.xml), let it publish reliably, or send smaller images '
                        '(docs/nodes.md)',
                    )
                )
        return remarks

    def _invisible(self) -> list[Remark]:
        if self._image is None:
            return []
        depth, encoding, mode = self._image
        if sees_something(depth, mode.range_min, mode.range_max):
            return []
        finding = explain(depth, encoding, mode.range_min, mode.range_max)
        if finding is None:
            return []
        return [
            Remark(
                finding.kind,
                f'clean/depth_image: no pixel is within the {mode.range_min:g} to '
                f'{mode.range_max:g} m of {mode.name}: {finding.text}',
                finding.wrong,
            )
        ]

    def _unpaired(self) -> list[Remark]:
        before, now = (
            self._paired,
            (self._pairing.paired['reflectivity'], self._pairing.unpaired['reflectivity']),
        )
        self._paired = now
        if now[0] > before[0] or now[1] == before[1]:
            return []
        return [
            Remark(
                'reflectivity unpaired',
                'clean/reflectivity: none has the stamp of a '
                'depth image: publish both with the same header.stamp',
            )
        ]
