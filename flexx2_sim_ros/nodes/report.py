"""The diagnostics of a camera node."""

from dataclasses import dataclass, field
import time

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from flexx2_sim_ros.nodes.gating import FrameGate, RateMeter
from flexx2_sim_ros.nodes.input_watch import InputWatch, Remark
import numpy as np

_SILENT_SECONDS = 3.0
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
    last_input : float
        When the last input came, by the monotonic clock, seconds.
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
    latencies: list[float] = field(default_factory=list)

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
        remarks: list[Remark],
    ) -> DiagnosticStatus:
        """Return the status to publish, and discard the latencies."""
        warnings, notes = self._find(rate_hz, watch, remarks)
        level = DiagnosticStatus.WARN if warnings else DiagnosticStatus.OK
        text = '; '.join(warnings + notes) if warnings else '; '.join(['streaming', *notes])
        latency = np.array(self.latencies or [np.nan]) * 1e3
        values = {
            'usecase': usecase,
            'nominal rate [Hz]': f'{rate_hz:g}',
            'input rate [Hz]': f'{self.input_rate.hz:.2f}',
            'output rate [Hz]': f'{self.output_rate.hz:.2f}',
            'inputs received': str(self.received),
            'frames published': str(self.published),
            "inputs dropped (not due at the mode's rate)": str(gate.early),
            'inputs dropped (repeated stamp)': str(gate.repeats),
            'inputs rejected': str(self.rejected),
            'stamps went back': str(gate.restarts),
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
        self, rate_hz: float, watch: InputWatch, remarks: list[Remark]
    ) -> tuple[list[str], list[str]]:
        # Warnings, and notes that need no action.
        warnings = [remark.text for remark in remarks if remark.warn]
        notes = [remark.text for remark in remarks if not remark.warn]
        if time.monotonic() - self.last_input > _SILENT_SECONDS:
            absent = watch.publishers('clean/depth_image') == 0
            warnings.insert(
                0, 'no input' + (': clean/depth_image has no publisher' if absent else '')
            )
        elif self.last_error:
            warnings.insert(0, f'input rejected: {self.last_error}')
        elif slow := self.slow(rate_hz):
            warnings.append(slow)
        return warnings, notes
