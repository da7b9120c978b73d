"""The diagnostics of a camera node."""

from dataclasses import dataclass, field
import time

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from flexx2_sim_ros.nodes.input_watch import InputWatch, Remark
from flexx2_sim_ros.nodes.late_frames import LateFrames
from flexx2_sim_ros.nodes.pacing import FrameGate, RateMeter
import numpy as np

_SILENT_SECONDS = 3.0
# Input without output for longer than this is said.
_STUCK_SECONDS = 1.0
# A rate counts as reached above this fraction of it: stamps jitter and are rounded.
_RATE_FRACTION = 0.95
_ENOUGH = 10


@dataclass
class Statistics:
    """
    Counters and rates of one camera node, and latencies since the last report.

    Attributes
    ----------
    input_rate, output_rate : RateMeter
        By stamps.
    received, published, rejected : int
        Inputs received, frames published, inputs that could not be used.
    invalid_fraction : float
        Fraction of invalid pixels of the last frame; NaN before the first frame.
    last_error : str
        Why the last input was rejected; empty if none was since the last report.
    last_input, unanswered : float
        When the last input came, and the first one after the last published frame, by the
        monotonic clock, seconds.
    delay : float
        How late frames are published on purpose, seconds.
    latencies : list of float
        Seconds from the arrival of an input to the publication of its frame.

    """

    input_rate: RateMeter = field(default_factory=RateMeter)
    output_rate: RateMeter = field(default_factory=RateMeter)
    received: int = 0
    published: int = 0
    rejected: int = 0
    invalid_fraction: float = float('nan')
    last_error: str = ''
    last_input: float = float('-inf')
    unanswered: float = float('inf')
    delay: float = 0.0
    latencies: list[float] = field(default_factory=list)

    def receive(self) -> None:
        """Count an input that came now."""
        self.received += 1
        self.last_input = time.monotonic()
        self.unanswered = min(self.unanswered, self.last_input)

    def publish(self, seconds: float) -> None:
        """Count a frame that was published now, this long after its input."""
        self.published += 1
        self.unanswered = float('inf')
        self.latencies.append(seconds)

    @property
    def is_silent(self) -> bool:
        """Whether no input has come for a while."""
        return time.monotonic() - self.last_input > _SILENT_SECONDS

    @property
    def is_stuck(self) -> bool:
        """Whether inputs come, but for too long no frame was published."""
        return time.monotonic() - self.unanswered > _STUCK_SECONDS + self.delay

    def slow(self, rate_hz: float) -> str:
        """Return a text if the input is slower than a rate in Hz, else an empty one."""
        hz = self.input_rate.hz
        if self.input_rate.samples < _ENOUGH or hz >= _RATE_FRACTION * rate_hz:
            return ''
        return f'input at {hz:.1f} Hz is slower than the mode'

    def report(
        self,
        name: str,
        serial: str,
        usecase: str,
        rate_hz: float,
        gate: FrameGate,
        watch: InputWatch,
        late: LateFrames,
        remarks: list[Remark],
    ) -> DiagnosticStatus:
        """
        Return the status to publish, and discard the latencies.

        Name, levels and the keys of the rate are those of the `FrequencyStatus` of
        diagnostic_updater: an error if nothing comes out.
        """
        stuck = _reason(gate, late) if self.is_stuck else ''
        warnings, notes = self._find(rate_hz, watch, remarks, stuck)
        level, dead = DiagnosticStatus.OK, self.is_silent or self.is_stuck
        if warnings:
            level = DiagnosticStatus.ERROR if dead else DiagnosticStatus.WARN
        text = '; '.join(warnings + notes) if warnings else '; '.join(['streaming', *notes])
        latency = np.array(self.latencies or [np.nan]) * 1e3
        values = {
            'usecase': usecase,
            'Target frequency (Hz)': f'{rate_hz:g}',
            'Actual frequency (Hz)': f'{0.0 if dead else self.output_rate.hz:.2f}',
            'input rate [Hz]': f'{0.0 if self.is_silent else self.input_rate.hz:.2f}',
            'inputs received': str(self.received),
            'frames published': str(self.published),
            "inputs dropped (not due at the mode's rate)": str(gate.early),
            'inputs dropped (repeated stamp)': str(gate.repeats),
            'inputs rejected': str(self.rejected),
            'stamps went back': str(gate.restarts),
            'frames waiting for their delay': str(late.waiting),
            'frames dropped while waiting': str(late.dropped),
            **watch.values(),
            'invalid share': f'{self.invalid_fraction:.4f}',
            'latency mean [ms]': f'{latency.mean():.2f}',
            'latency max [ms]': f'{latency.max():.2f}',
        }
        self.latencies.clear()
        self.last_error = ''
        return DiagnosticStatus(
            level=level,
            name=f'{name}: camera',
            hardware_id=serial,
            message=text,
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )

    def _find(
        self, rate_hz: float, watch: InputWatch, remarks: list[Remark], stuck: str
    ) -> tuple[list[str], list[str]]:
        # Warnings, and notes that need no action.
        warnings = [remark.text for remark in remarks if remark.warn]
        notes = [remark.text for remark in remarks if not remark.warn]
        if self.is_silent:
            absent = watch.publishers('clean/depth_image') == 0
            warnings.insert(
                0, 'no input' + (': clean/depth_image has no publisher' if absent else '')
            )
        elif self.last_error:
            warnings.insert(0, f'input rejected: {self.last_error}')
        elif stuck:
            warnings.insert(0, f'no frame is published: {stuck}')
        elif slow := self.slow(rate_hz):
            warnings.append(slow)
        return warnings, notes


def _reason(gate: FrameGate, late: LateFrames) -> str:
    # Why inputs come but no frame goes out, with the counter of this reason.
    if late.waiting:
        return (
            f'{late.waiting} frames wait for their delay, and the clock of this node is at '
            f'{late.clock} ns (see use_sim_time, and who publishes /clock)'
        )
    if gate.standing:
        return (
            'clean/depth_image: header.stamp: must be new for every image, got the same '
            f'{gate.standing + 1} times (does its publisher wait for /clock?)'
        )
    return (
        'clean/depth_image: header.stamp: must advance to the next frame of the mode, '
        f'{gate.early} images were not due'
    )
