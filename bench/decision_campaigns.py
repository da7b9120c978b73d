"""
Simulated campaigns of which the decisions of the diagnosis are calibrated, one after the other.

The camera is the blind camera of the benchmark, which shares no effect with the catalogue, or,
in every fourth campaign, the package's own. Half of these show bare walls, with any of the shipped
cameras. Each campaign is drawn from the numbers of a part of `PARTS`, diagnosed, and, where
effects are named, checked on other scenes of the same camera. Development seeds only. The novel
effects are those of `bench.gap_novel`, not the benchmark's.
"""

from functools import cache
import math
from pathlib import Path
import subprocess
import time

from bench.gap_campaigns import write_campaign
from bench.gap_novel import NOVEL
from bench.gap_truth import rewrite
from bench.wall_campaigns import profile_for, SHOWN, write_walls
from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.gap import diagnose, measure
import numpy as np
from study.benchmark.design import MODES, Planned
from study.benchmark.realised import realised_gap
from study.benchmark.seeds import DEVELOPMENT
from study.blind import BlindCamera
from study.blind.catalogue import CATALOGUE

# What is drawn, and how often; the strength is log-uniform between two numbers.
SMALL = {
    'group': {'none': 0.26, 'single': 0.44, 'pair': 0.12, 'left_out': 0.08, 'novel': 0.10},
    'camera': {'blind': 0.75, 'own': 0.25},
    'usecase': dict.fromkeys(MODES, 0.5),
    'recordings': {2: 0.03, 3: 0.12, 4: 0.17, 5: 0.15, 6: 0.2, 8: 0.28, 12: 0.05},
    'frames': {1: 0.03, 3: 0.1, 6: 0.32, 12: 0.4, 24: 0.15},
    'width': {64: 0.25, 80: 0.5, 112: 0.25},
    'pose_mm': {0.0: 0.1, 1.0: 0.14, 2.0: 0.52, 5.0: 0.2, 10.0: 0.04},
    'inside': {'as in the profile': 0.7, 'different': 0.3},  # of the blind camera: `INSIDE`
    'truth': {'exact': 0.8, 'masked': 0.12, 'constrained': 0.08},  # constrained: own camera only
    'scene': {'room': 0.5, 'walls': 0.5},  # walls: own camera only
    'strength': (0.1, 3.0),
}
# Campaigns of the benchmark's size: what the errors of poses leave grows with the number of pixels
# and frames.
LARGE = {
    **SMALL,
    'group': {'none': 0.36, 'single': 0.38, 'pair': 0.08, 'left_out': 0.1, 'novel': 0.08},
    'camera': {'blind': 1.0},
    'recordings': {8: 1.0},
    'frames': {20: 1.0},
    'width': {224: 1.0},
    'pose_mm': {0.0: 0.1, 2.0: 0.45, 5.0: 0.45},
    'truth': {'exact': 1.0},
    'scene': {'room': 1.0},
    'strength': (0.25, 2.0),
}
# Those without an effect: few of them leave a large loss, and these few are the false alarms.
QUIET = {**LARGE, 'group': {'none': 1.0}, 'pose_mm': {0.0: 0.05, 2.0: 0.7, 5.0: 0.25}}
# Small campaigns of cameras with several effects, as real ones have.
MANY = {
    **SMALL,
    'group': {'many': 1.0},
    'camera': {'blind': 1.0},
    'recordings': {1: 0.05, 2: 0.05, 3: 0.1, 4: 0.15, 6: 0.2, 8: 0.3, 12: 0.1, 20: 0.05},
    'frames': {6: 0.5, 12: 0.5},
    'truth': {'exact': 0.85, 'masked': 0.15},
    'scene': {'room': 1.0},
}
PARTS = {'small': SMALL, 'large': LARGE, 'quiet': QUIET, 'many': MANY}
_EFFECTS = 3, 14  # of the campaigns of `MANY`
# What differs inside a camera with an effect: for each field of `Internals` the lowest and highest
# value (log-uniform), or the values. For other effects: one modulation frequency.
INSIDE = {
    'wiggling': {'wave_m': (0.25, 2.0)},
    'offset': {'axial': (True,)},
    'warm_up_drift': {'axial': (True,)},
    'amplitude_bias': {'knee': (0.03, 1.0)},
    'flying_pixels': {'footprint': ('round', 'gauss'), 'footprint_px': (1.2, 3.0)},
    'stray_light': {'scatter': ('gauss', 'even'), 'scatter_px': (3.0, 12.0)},
    'spatial_filter': {'window': ('box', 'gauss'), 'window_px': (3, 5, 7, 9)},
    'temporal_filter': {'memory': ('second', 'mean'), 'memory_frames': (2, 3, 4, 5)},
    'low_signal_dropout': {'light_scale': (0.2, 8.0)},
    'saturation': {'light_scale': (0.2, 8.0)},
    'time_offset': {'latency_s': (0.02, 0.2)},
}
_MHZ = {'mhz': (25.0, 105.0)}
_FIRST = 100_000  # index of the first seed
_SCENES, _STEP = 200_000, 1000  # likewise of the scenes; fresh ones lie between
# How far the scenes of a part are from those of the first.
_BETWEEN = {'small': 0, 'large': 250, 'quiet': 100, 'many': 400}
MOST = (1_000_000 - _SCENES) // _STEP  # campaigns of a part
_DEGREES_PER_MM = 0.0625


def plan(part, number):
    """
    Draw a campaign.

    * `part`: a key of `PARTS`
    * `number`: which of its campaigns, 0 to `MOST` - 1

    Returns the case, and a dict of what it does not say: ``camera``, ``truth``, ``scene`` and
    ``novel``.
    """
    seed = DEVELOPMENT.seed(_FIRST + MOST * list(PARTS).index(part) + number)
    rng = np.random.default_rng(seed)
    *tables, (_, strengths) = PARTS[part].items()
    drawn = {
        name: list(table)[int(rng.choice(len(table), p=list(table.values())))]
        for name, table in tables
    }
    group = drawn['group']
    count = {'none': 0, 'novel': 0, 'pair': 2}.get(group, 1)
    if group == 'many':
        count = int(rng.integers(*_EFFECTS, endpoint=True))
    own = drawn['camera'] == 'own'
    walls = own and drawn['scene'] == 'walls'
    known = SHOWN if walls else sorted(CATALOGUE)
    names = sorted(str(name) for name in rng.choice(known, count, replace=False))
    low, high = map(math.log, strengths)
    effects = {name: round(float(np.exp(rng.uniform(low, high))), 3) for name in names}
    more = {
        'camera': drawn['camera'],
        'truth': 'exact' if drawn['truth'] == 'constrained' and not own else drawn['truth'],
        'scene': 'walls' if walls else 'room',
        'novel': str(rng.choice(sorted(NOVEL))) if group == 'novel' else '',
    }
    case = Planned(
        group,
        drawn['usecase'],
        effects,
        seed,
        DEVELOPMENT.seed(_SCENES + _STEP * number + _BETWEEN[part]),
        drawn['pose_mm'],
        tuple(names) if group == 'left_out' else (),
        drawn['width'],
        round(drawn['width'] * 172 / 224),
        drawn['recordings'],
        drawn['frames'],
        internals={} if own or drawn['inside'] != 'different' else _inside(names, rng),
    )
    return case, more


def _inside(names, rng):
    # What differs inside the camera, for its effects.
    out = {}
    fields = [INSIDE[name] for name in names if name in INSIDE] or [_MHZ]
    for field, values in (item for one in fields for item in one.items()):
        if all(isinstance(value, float) for value in values):
            low, high = map(math.log, values)
            out[field] = round(float(np.exp(rng.uniform(low, high))), 4)
        else:
            out[field] = values[int(rng.integers(len(values)))]
    return out


def run(which):
    """
    Record and diagnose a campaign, given by part and number; see `plan`.

    Returns, for a line of JSON, ``part``, ``number``, ``planned``, ``more`` (see `plan`),
    ``diagnosis`` (without what is drawn on its page), ``realised``, ``seconds`` and ``code``.
    """
    part, number = which
    case, more = plan(part, number)
    began = time.process_time()
    with scratch_folder() as folder:
        campaign = folder / 'campaign'
        campaign.mkdir()
        _record(case, more, campaign)
        profile = profile_for(case.seed, case.effects) if more['scene'] == 'walls' else None
        table = diagnose(campaign, profile=profile, without=case.without, seed=number)
        realised = None
        if table['effects'] and more['camera'] == 'blind' and case.effects:
            realised = realised_gap(case, table, folder / 'cache', measure)
    kept = (
        'verdict',
        'effects',
        'alternatives',
        'not_decidable',
        'gap',
        'calibration',
        'evidence',
    )
    return {
        'part': part,
        'number': number,
        'planned': case.to_json(),
        'more': more,
        'diagnosis': {key: table[key] for key in kept},
        'realised': realised,
        'seconds': round(time.process_time() - began, 2),
        'code': code(),
    }


def _record(case, more, folder):
    table = {name: {'strength': value} for name, value in case.effects.items()}
    pose = case.pose_mm / 1000, case.pose_mm * _DEGREES_PER_MM
    if more['scene'] == 'walls':
        write_walls(
            folder,
            profile=profile_for(case.seed, case.effects),
            effects=table,
            seed=case.seed,
            recordings=case.recordings,
            frames=case.frames,
            width=case.width,
            pose=pose,
        )
    elif more['camera'] == 'own':
        write_campaign(
            folder,
            effects=table,
            seed=case.seed,
            recordings=case.recordings,
            frames=case.frames,
            usecase=case.usecase,
            pose=pose,
            scale=case.width / 224,
            moving=0 if more['truth'] == 'constrained' else case.recordings * 3 // 8,
        )
    else:
        BlindCamera(case.case).record(folder)
    if more['novel']:
        _change(folder, more['novel'], case.seed)
    if more['truth'] != 'exact':
        rewrite(folder, more['truth'], case.seed % 100_000)


def _change(folder, novel, seed):
    # Gives the recordings an effect outside the catalogue.
    rng = np.random.default_rng([seed, 7])
    for i, path in enumerate(sorted(folder.glob('*.npz'))):
        with np.load(path) as archive:
            content = dict(archive)
        depth = NOVEL[novel](content['depth'], {**content, 'rng': rng, 'index': i})
        np.savez(path, **{**content, 'depth': depth.astype(np.float32)})


@cache
def code():
    """Return the hash of the committed files of the diagnosis, with ``+`` if some differ."""
    folder = 'flexx2_sim_ros/gap'
    return _git('rev-parse', f'HEAD:{folder}') + '+' * bool(_git('status', '-s', folder))


def _git(*arguments):
    done = subprocess.run(
        ['git', *arguments],
        cwd=Path(__file__).parent.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip()
