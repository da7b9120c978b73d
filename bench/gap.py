"""Time and memory of a diagnosis, by the number of recordings and frames."""

from pathlib import Path
import tempfile
import time

from bench.gap_campaigns import write_campaign
from bench.timing import peak_megabytes
from flexx2_sim_ros.gap import diagnose

# Recordings and frames, 224 x 172; first those of the usual campaign.
_SIZES = ((8, 20), (4, 20), (8, 10), (8, 40), (16, 20))


def run(sizes=_SIZES):
    """Print time and memory."""
    usual = sizes[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for recordings, frames in sizes:
            write_campaign(
                folder / f'{recordings}x{frames}',
                seed=7,
                recordings=recordings,
                frames=frames,
                moving=recordings * 3 // 8,
                effects={'wiggling': {}},
            )
        first = folder / f'{usual[0]}x{usual[1]}'
        diagnose(first)  # compiles
        cost = {}
        for recordings, frames in sizes:
            start = time.process_time()
            diagnose(folder / f'{recordings}x{frames}')
            cost[recordings, frames] = time.process_time() - start
        unit = cost[usual]
        print(
            f'{usual[0]} recordings of {usual[1]} frames: {unit:.1f} s of a core; others in '
            'units of that'
        )
        for (recordings, frames), seconds in cost.items():
            print(f'  {recordings:2d} recordings of {frames} frames: {seconds / unit:.2f}')
        start = time.perf_counter()
        diagnose(first, jobs=2)
        print(
            f'two processes: {time.perf_counter() - start:.1f} s (wanted: 30 s); largest '
            f'resident memory of one: {peak_megabytes():.0f} MB (wanted: 2,000 MB)'
        )
