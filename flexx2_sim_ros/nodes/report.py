"""What a camera node has done lately, as diagnostics."""

from dataclasses import dataclass, field
import time

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from flexx2_sim_ros.nodes.gating import FrameGate, RateMeter
import numpy as np

_SILENT_SECONDS = 3.0
# A rate counts as reached within this share: stamps jitter and are rounded.
_RATE_SHARE = 0.95
_ENOUGH = 10


@dataclass
class Statistics:
    """
    Counters and meters of one camera node; latency since the last report.

    Attributes
    ----------
    input_rate, output_rate : RateMeter
        By stamps.
    received, published, rejected : int
        Inputs received, frames published, inputs that could not be used.
    invalid_share : float
        Of the last frame computed, NaN before there is one.
    last_error : str
        Why the last input was rejected, empty when none was since the last report.
    last_input : float
        When the last input came, by the monotonic clock, seconds.
    latencies : list of float
        Seconds from taking an input up to having published its frame.

    """

    input_rate: RateMeter = field(default_factory=RateMeter)
    output_rate: RateMeter = field(default_factory=RateMeter)
    received: int = 0
    published: int = 0
    rejected: int = 0
    invalid_share: float = float('nan')
    last_error: str = ''
    last_input: float = float('-inf')
    latencies: list[float] = field(default_factory=list)

    def report(self, name: str, serial: str, usecase: str, rate_hz: float,
               gate: FrameGate) -> DiagnosticStatus:
        """Return the status to publish and forget the latencies reported."""
        silent = time.monotonic() - self.last_input > _SILENT_SECONDS
        slow = (self.input_rate.samples >= _ENOUGH
                and self.input_rate.hz < _RATE_SHARE * rate_hz)
        if silent:
            level, text = DiagnosticStatus.WARN, 'no input'
        elif self.last_error:
            level, text = DiagnosticStatus.WARN, f'input rejected: {self.last_error}'
        elif slow:
            level, text = DiagnosticStatus.WARN, (
                f'input at {self.input_rate.hz:.1f} Hz is slower than the mode')
        else:
            level, text = DiagnosticStatus.OK, 'streaming'
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
            'invalid share': f'{self.invalid_share:.4f}',
            'latency mean [ms]': f'{latency.mean():.2f}',
            'latency max [ms]': f'{latency.max():.2f}',
        }
        self.latencies.clear()
        self.last_error = ''
        return DiagnosticStatus(
            level=level, name=f'{name}: camera', hardware_id=serial, message=text,
            values=[KeyValue(key=key, value=value) for key, value in values.items()])
