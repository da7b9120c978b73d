"""
Does the truth lie within the cameras that `flexx2 gap randomise` draws.

Simulation-based calibration (Talts et al. 2018): two parameters of two effects are drawn, a
campaign is simulated and diagnosed, and the rank of each true parameter among draws of the
randomisation is counted. Ranks are uniform if the spread is right: they pile up at both ends if
it is too narrow, and in the middle if it is too wide. The camera is the simulator's, so errors in
the form of an effect are not in it. Only effects that the diagnosis names count. Development
seeds only.

python -m bench.gap_randomise --seeds 1400,1401
"""

import argparse
from pathlib import Path

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import diagnose, randomise
from flexx2_sim_ros.gap.randomise import overall
from flexx2_sim_ros.validation.benchmark.seeds import DEVELOPMENT
import numpy as np

# Effects with one fitted parameter, and which.
_PARAMETERS = {
    'offset': 'bias',
    'excess_noise': 'factor',
    'heavy_tails': 'share',
    'temporal_filter': 'share',
    'low_signal_dropout': 'strength',
    'stray_light': 'share',
}
_FROM, _TO = 0.7, 1.6  # times the typical value: weaker effects are not found
_DRAWS = 400
_BINS = 5


def main() -> None:
    """Print a line for each campaign, and the histogram of ranks."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--seeds', default='1400')
    parser.add_argument('--recordings', type=int, default=6)
    parser.add_argument('--frames', type=int, default=12)
    parser.add_argument('--jobs', type=int, default=1)
    arguments = parser.parse_args()
    others = [name for name in registry() if name not in _PARAMETERS]
    ranks, factors = [], []
    for seed in map(int, arguments.seeds.split(',')):
        rng = np.random.default_rng(seed)
        names = rng.choice(list(_PARAMETERS), 2, replace=False).tolist()
        true = {name: _drawn(name, rng) for name in names}
        with scratch_folder() as folder:
            write_campaign(
                folder / 'campaign',
                seed=DEVELOPMENT.seed(seed),
                effects={name: {_PARAMETERS[name]: value} for name, value in true.items()},
                recordings=arguments.recordings,
                frames=arguments.frames,
                scale=0.5,
                moving=1,
            )
            out = folder / 'diagnosis'
            diagnose(folder / 'campaign', without=others, out=out, jobs=arguments.jobs)
            own, factor, text = _ranks(out, true, seed)
        ranks += own
        factors += factor
        print(f'{seed} {text}', flush=True)
    counts = np.histogram(ranks, _BINS, (0, 1))[0]
    inside = sum(0.05 <= rank <= 0.95 for rank in ranks)
    print(f'ranks in {_BINS} bins: {counts.tolist()}')
    print(f'{inside} of {len(ranks)} truths within 90 % of the draws')
    if factors:
        typical = overall(dict(enumerate(factors)))  # type: ignore[arg-type]
        print(f'{typical:.1f} times narrower than the catalogue (geometric mean)')


def _drawn(name: str, rng: np.random.Generator) -> float:
    (item,) = (one for one in registry()[name].parameters() if one.name == _PARAMETERS[name])
    return float(np.clip(item.default * rng.uniform(_FROM, _TO), item.low, item.high))


def _ranks(
    diagnosis: Path, true: dict[str, float], seed: int
) -> tuple[list[float], list[float], str]:
    try:
        found = randomise(diagnosis)
    except InputError as error:
        return [], [], str(error)
    names = [one.name for one in found.randomisation.distributions]
    values, _ = found.randomisation.values(_DRAWS, seed)
    ranks, factors, texts = [], [], []
    for effect, truth in true.items():
        name = f'{effect}.{_PARAMETERS[effect]}'
        if name not in names:
            texts.append(f'{effect} {truth:.3g} not named')
            continue
        drawn = values[:, names.index(name)]
        rank = float((drawn < truth).mean())
        ranks.append(rank)
        factors.append(found.narrower[name])
        texts.append(f'{effect} {truth:.3g} drawn {drawn.mean():.3g} +- {drawn.std():.2g}')
        texts[-1] += f' rank {rank:.2f}'
    return ranks, factors, '; '.join(texts)


if __name__ == '__main__':
    main()
