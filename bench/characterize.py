"""The whole campaign of the paper, simulated and analysed: results, time and memory."""

import os
from pathlib import Path
import resource
import shutil
import tempfile
import time

from bench.timing import peak_megabytes
from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.characterize.analysis import Characterization, characterize, ModeResult
from flexx2_sim_ros.characterize.campaign import capture, conditions, FRAMES
from flexx2_sim_ros.characterize.lateral import procedure_bias
from flexx2_sim_ros.cli.characterize_table import print_result
from flexx2_sim_ros.config_file import read_section
from flexx2_sim_ros.paths import config_dir
import numpy as np

_WORKERS = 2
_GIGABYTES = 6


def run() -> None:
    """Print results, time and memory."""
    with tempfile.TemporaryDirectory() as folder:
        free = shutil.disk_usage(folder).free / 1e9
        if free < 1.2 * _GIGABYTES:
            print(f'{folder}: {free:.1f} GB free, wanted {1.2 * _GIGABYTES:.1f}: left out')
            return
        _campaign(Path(folder))
    _linearity()
    _procedure()


def _campaign(folder: Path) -> None:
    profile = flexx2()
    wanted = conditions(profile)
    start, before = time.perf_counter(), _cpu_seconds()
    for _ in capture(folder, wanted, profile, frames=FRAMES, workers=_WORKERS):
        pass
    captured = time.perf_counter()
    result = characterize(folder, workers=_WORKERS)
    fitted = time.perf_counter()
    child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(
        f'{len(wanted)} recordings, {len(wanted) * FRAMES:,} frames, {_WORKERS} processes: '
        f'simulated in {captured - start:.0f} s, analysed in {fitted - captured:.0f} s '
        f'(wanted: 240 s together); {_cpu_seconds() - before:.0f} s of a core, '
        f'load {os.getloadavg()[0]:.1f}'
    )
    print(
        f'largest resident memory: {peak_megabytes():.0f} MB + {_WORKERS} x {child:.0f} MB '
        '(wanted: 1,500 MB)\n'
    )
    print_result(result)
    _against_truth(result)


def _cpu_seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def _against_truth(result: Characterization) -> None:
    paper = read_section(config_dir() / 'paper.yaml', 'divergence', dict)
    for mode in result.modes:
        true = flexx2().mode(mode.usecase).noise
        near, far = (end(m.distance for m in mode.measurements) for end in (min, max))
        z, theta = np.meshgrid(np.linspace(near, far, 50), np.radians(np.linspace(0, 60, 25)))
        ratio = mode.axial.model().sigma_z(z, theta) / true.sigma_z(z, theta)
        low, high = mode.axial.interval_n or (np.nan, np.nan)
        lateral = [cell.lateral for cell in mode.cells if cell.lateral is not None]
        print(
            f'\n{mode.usecase}: sigma_z / truth {ratio.min():.4f} to {ratio.max():.4f} over '
            f'{near:.2f} to {far:.2f} m, 0 to 60 degrees (wanted 0.98 to 1.02); n '
            f'{mode.axial.coefficients["n"]:.1f} in {low:.3f} to {high:.3f}; sigma_x / truth '
            f'{mode.sigma_x / true.sigma_x:.4f} (wanted 0.97 to 1.03)'
        )
        print(
            f'  {"KL [nats]":14s}'
            + ''.join(f'{angle:9.0f}°' for angle in (0, 15, 30, 45, 60))
            + '      mean   lateral'
        )
        print(
            f'  {"measured":14s}'
            + ''.join(f'{kl:10.4f}' for kl in _by_angle(mode, 'raw'))
            + f'{np.mean([cell.axial.raw for cell in mode.cells]):10.4f}'
            f'{np.mean([kl.raw for kl in lateral]):10.4f}  (wanted: mean at most 0.005)'
        )
        print(
            f'  {"less its floor":14s}'
            + ''.join(f'{kl:z10.4f}' for kl in _by_angle(mode, 'debiased'))
            + f'{np.mean([cell.axial.debiased for cell in mode.cells]):z10.4f}'
            f'{np.mean([kl.debiased for kl in lateral]):z10.4f}'
        )
        row = paper[mode.usecase]
        kls = [row['axial_kl'][angle] for angle in (0, 15, 30, 45, 60)]
        print(
            f'  {"the paper":14s}'
            + ''.join(f'{kl:10.3f}' for kl in kls)
            + f'{np.mean(kls):10.3f}{row["lateral_kl"]:10.3f}'
        )


def _by_angle(mode: ModeResult, kind: str) -> list[float]:
    return [
        float(
            np.mean(
                [
                    getattr(cell.axial, kind)
                    for cell in mode.cells
                    if cell.measurement.label[1] == angle
                ]
            )
        )
        for angle in (0, 15, 30, 45, 60)
    ]


def _linearity() -> None:
    profile = flexx2()
    wanted = conditions(profile, ['Mode_9_30fps'], [1.0, 2.0], [0, 45])
    counts, seconds = (75, 150, 300, 600), []
    for frames in (75, *counts):  # run once before, to compile
        with tempfile.TemporaryDirectory() as folder:
            # Rendering does not depend on the number of frames: it is not counted.
            tasks = capture(Path(folder), wanted, profile, frames=frames)
            next(tasks)
            start = time.process_time()
            for _ in tasks:
                pass
            characterize(Path(folder))
            seconds.append(time.process_time() - start)
    del seconds[0]
    slope, fixed = np.polyfit(counts, np.array(seconds) / len(wanted), 1)
    print(
        '\ncost of a recording, one core: '
        + ', '.join(
            f'{frames} frames {1e3 * s / len(wanted):.0f} ms'
            for frames, s in zip(counts, seconds, strict=True)
        )
        + f'; {1e3 * slope:.2f} ms a frame + {1e3 * fixed:.0f} ms'
    )


def _procedure() -> None:
    print(
        "\nwhat the paper's edge procedure makes of a known jitter [px], by depth step in units "
        'of depth noise'
    )
    steps = (1000, 20, 10, 8, 6, 5)
    print('  put in' + ''.join(f'{step:9d}' for step in steps) + '   sqrt(sigma² + 1/12)')
    for sigma in (0.0, 0.3, 0.864, 1.098, 1.649):
        print(
            f'  {sigma:6.3f}'
            + ''.join(f'{procedure_bias(sigma, step, 1.0):9.3f}' for step in steps)
            + f'{np.sqrt(sigma**2 + 1 / 12):9.3f}'
        )
