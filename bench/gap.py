"""Time and memory of a diagnosis, by the number of recordings and frames."""

from pathlib import Path
import tempfile
import time

from bench.gap_campaigns import write_campaign
from bench.timing import peak_megabytes
from flexx2_sim_ros.gap import diagnose

_RECORDINGS, _FRAMES = 8, 20  # the usual campaign, 224 x 172
_SIZES = ((4, 20), (8, 10), (8, 20), (8, 40), (16, 20))


def run() -> None:
    """Print time and memory."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for recordings, frames in _SIZES:
            write_campaign(
                folder / f'{recordings}x{frames}',
                seed=7,
                recordings=recordings,
                frames=frames,
                moving=recordings * 3 // 8,
                effects={'wiggling': {}},
            )
        usual = folder / f'{_RECORDINGS}x{_FRAMES}'
        diagnose(usual)  # compiles
        cost = {}
        for recordings, frames in _SIZES:
            start = time.process_time()
            diagnose(folder / f'{recordings}x{frames}')
            cost[recordings, frames] = time.process_time() - start
        unit = cost[_RECORDINGS, _FRAMES]
        print(
            f'{_RECORDINGS} recordings of {_FRAMES} frames: {unit:.1f} s of a core; others in '
            'units of that'
        )
        for (recordings, frames), seconds in cost.items():
            print(f'  {recordings:2d} recordings of {frames} frames: {seconds / unit:.2f}')
        start = time.perf_counter()
        diagnose(usual, jobs=2)
        print(
            f'two processes: {time.perf_counter() - start:.1f} s (wanted: 30 s); largest '
            f'resident memory of one: {peak_megabytes():.0f} MB (wanted: 2,000 MB)'
        )
