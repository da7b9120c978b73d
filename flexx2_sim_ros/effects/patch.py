"""A correction without a cause, for a gap that no effect explains; loadable, not listed."""

from dataclasses import make_dataclass, replace
from typing import Any, ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import fill_normals, stamp_words
import numpy as np

COVARIATES = ('distance', 'incidence', 'log_amplitude')
SLOTS = 14
# Second counter words of its own, far from those in physics/philox.py.
_STREAM_SCALE, _STREAM_LOSS = 1001, 1002
_UNUSED = 1e6


class _Patch(Effect):
    """How the correction acts; its table of parameters is added below."""

    name: ClassVar[str] = 'residual_patch'
    listed: ClassVar[bool] = False
    stage: ClassVar[Stage] = Stage.STORAGE
    order: ClassVar[int] = -10
    title: ClassVar[str] = 'PATCH WITHOUT A CAUSE: bias, noise and loss binned over one covariate'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str] = 'fitted by flexx2 gap diagnose to what no effect explains'

    def apply(self, state: FrameState) -> None:
        """Shift, scale and lose the measured depth by the bin of each pixel."""
        with np.errstate(divide='ignore', invalid='ignore'):
            value = (
                state.depth,
                np.degrees(np.arccos(np.clip(state.cosine, 0, 1))),
                np.log(state.amplitude),
            )[int(self._of('covariate_index'))]
        place = np.searchsorted(self._row('edge', SLOTS - 1), value)
        s = np.float32(self.strength)
        bias, loss = s * self._row('bias')[place], s * self._row('loss')[place]
        scale = np.maximum(1 + s * (self._row('scale')[place] - 1), 0)
        normals = np.empty(state.depth.shape, np.float32)
        low, high = stamp_words(state.stamp)
        fill_normals(state.key, low, high, _STREAM_SCALE, normals.ravel())
        more = np.sqrt(np.maximum(scale**2 - 1, 0)) * state.sigma * normals
        state.measured = (
            state.depth + np.minimum(scale, 1) * (state.measured - state.depth) + more + bias
        ).astype(np.float32)
        state.measured[state.uniforms(_STREAM_LOSS) <= loss] = np.nan

    def bias_alone(self) -> 'Effect':
        """Return the correction of the bias without those of noise and loss."""
        neutral = {f'scale_{i}': 1.0 for i in range(SLOTS)} | {
            f'loss_{i}': 0.0 for i in range(SLOTS)
        }
        return replace(self, **neutral)

    def _of(self, name: str) -> float:
        return float(getattr(self, name))

    def _row(self, name: str, count: int = SLOTS) -> np.ndarray:
        return np.array([self._of(f'{name}_{i}') for i in range(count)], np.float32)


def _fields() -> list[tuple[str, type, Any]]:
    text = 'bins over 0 distance (m), 1 incidence (deg), 2 log amplitude'
    out: list[tuple[str, type, Any]] = [
        ('covariate_index', float, parameter(0.0, 0.0, 2.0, '', text))
    ]
    for name, count, default, low, high, unit, what in (
        ('edge', SLOTS - 1, _UNUSED, -100.0, _UNUSED, '', 'between bins'),
        ('bias', SLOTS, 0.0, -1.0, 1.0, 'm', 'added in the bin'),
        ('scale', SLOTS, 1.0, 0.1, 10.0, '', 'on the noise in the bin'),
        ('loss', SLOTS, 0.0, 0.0, 1.0, '', 'fraction of pixels lost in the bin'),
    ):
        out += [
            (f'{name}_{i}', float, parameter(default, low, high, unit, what)) for i in range(count)
        ]
    return out


ResidualPatch: Any = make_dataclass(
    'ResidualPatch',
    _fields(),
    bases=(_Patch,),
    frozen=True,
    namespace={'__doc__': 'A correction without a cause.'},
)
ResidualPatch.__module__ = __name__
