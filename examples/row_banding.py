"""Row banding: a sinusoidal bias from row to row, as an effect in a package of its own."""

from dataclasses import dataclass
import math
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


@dataclass(frozen=True)
class RowBanding(Effect):
    """A reference voltage that swings while rows are read out."""

    name: ClassVar[str] = 'row_banding'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 20
    title: ClassVar[str] = 'readout: a bias that swings from row to row'
    covariate: ClassVar[str] = 'image'
    changes: ClassVar[tuple[str, ...]] = ('bias',)
    source: ClassVar[str] = 'assumed: an example of a plug-in'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = tuple(
        grid(
            'amplitude', (0.001, 0.002, 0.004), 0.0, 0.02, f'{rows:g} rows', few=False, period=rows
        )
        for rows in (12.0, 24.0, 48.0)
    )
    repeats: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('pose',)
    family: ClassVar[str] = 'function of the row'
    picture: ClassVar[Picture] = Picture('along_row')

    amplitude: float = parameter(0.002, -0.1, 0.1, 'm', 'of the swing')
    period: float = parameter(24.0, 2.0, 500.0, 'px', 'rows per swing')

    def apply(self, state: FrameState) -> None:
        """Add the swing of each row to the depth of all frequencies."""
        row = np.arange(state.depth.shape[0], dtype=np.float32)[:, None]
        swing = np.sin(np.float32(2.0 * math.pi / self.period) * row)
        state.add_shift(np.float32(self.strength * self.amplitude) * swing)
