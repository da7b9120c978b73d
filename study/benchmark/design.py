"""Which cases the benchmark has."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
import json
import math
from typing import Any

from flexx2_sim_ros.effects import of_role
import numpy as np
from study.benchmark.seeds import SeedRange
from study.blind import Case, CATALOGUE, Internals, NOVEL, SceneKey, VARIED

MODES = ('Mode_5_30fps', 'Mode_9_30fps')
# Strength: how many cases of each effect and mode.
STRENGTHS = {0.25: 1, 0.5: 2, 1.0: 2, 2.0: 1}
_NONE = 50  # for each mode
_NONE_HIDDEN = 12  # with a part of the ground truth
_PAIRS = 20
_NOVEL_REPEATS = 2
_SCENE_SETS = 16  # for each mode and pose error: what is rendered is shared
_UNUSUAL_SCENE_SETS = 4
_USUAL_POSE_MM = 2.0
_QUICK_SINGLES = (
    'temporal_filter',
    'spatial_filter',
    'excess_noise',
    'low_signal_dropout',
    'multipath',
    'saturation',
)
_QUICK_NOVEL = ('row_bands', 'block_compression')
# Cameras with many effects, by their number: of mixed strengths (log-uniform), and small images.
_COUNTS = 4, 8, 14
_MANY = 8
_MIXED = 0.25, 2.0
_SMALL = {'width': 112, 'height': 86, 'frames': 12}
_LARGE = {'width': 320, 'height': 240, 'frames': 12}
# What differs inside: each field of `Internals` with probability 0.5, between two values or one of
# several.
_INSIDE: dict[str, tuple[Any, ...]] = {
    'mhz': (25.0, 105.0),
    'wave_m': (0.25, 2.0),
    'footprint': ('round', 'gauss'),
    'footprint_px': (1.2, 3.0),
    'scatter': ('gauss', 'even'),
    'scatter_px': (3.0, 12.0),
    'window': ('box', 'gauss'),
    'window_px': (3, 5, 7, 9),
    'memory': ('second', 'mean'),
    'light_scale': (0.3, 4.0),
    'knee': (0.03, 1.0),
    'latency_s': (0.02, 0.2),
    'lost': (0.03, 0.3),
}
# Effects that one scene of eight may show, and that a camera may begin to have midway.
_IN_ONE_SCENE = 'ambient_light', 'low_signal_dropout', 'multipath', 'saturation', 'stray_light'
_MIDWAY = 'spatial_filter', 'temporal_filter', 'excess_noise', 'depth_scale', 'random_dropout'


def drawn(rng: np.random.Generator, count: int) -> tuple[dict[str, float], dict[str, Any]]:
    """Draw the strengths of so many effects, by name, and what differs inside the camera."""
    names = sorted(set(CATALOGUE) - {of_role('pose').name})  # that is no effect of a camera
    low, high = map(math.log, _MIXED)
    effects = {
        str(name): round(float(np.exp(rng.uniform(low, high))), 3)
        for name in sorted(rng.choice(names, count, replace=False))
    }
    inside: dict[str, Any] = {}
    for name, values in _INSIDE.items():
        if rng.random() < 0.5:
            continue
        if len(values) == 2 and all(isinstance(one, float) for one in values):
            low, high = map(math.log, values)
            inside[name] = round(float(np.exp(rng.uniform(low, high))), 4)
        else:
            inside[name] = values[int(rng.integers(len(values)))]
    return effects, inside


@dataclass(frozen=True)
class Planned:
    """
    One case.

    * `group`: ``single``, ``none``, ``pair``, ``novel``, ``left_out``, ``internals``, ``truth``,
      ``many``, ``one_scene`` or ``midway``
    * `effects`: strength by name
    * `seed`, `scene_seed`: of camera and nuisances, and of the scenes
    * `pose_mm`: nuisance pose error, see `SceneKey`
    * `without`: effects left out of the diagnosis's catalogue
    * `realise`: whether the predicted shrinkage is checked on fresh recordings
    * `baselines`: whether the baselines look at it too
    * `internals`: what differs inside the camera from its profile; see `Internals`
    * `only`: the recordings that have the effects; empty: all
    * `hidden`: whether about 30 % of the ground truth is unknown; see `hide_truth`
    * `half`: 0 or 1: all cases of the first half run before those of the second. Each half has
      about half of each group, so that a run that stops in between has all of them.
    """

    group: str
    usecase: str
    effects: dict[str, float]
    seed: int
    scene_seed: int
    pose_mm: float = _USUAL_POSE_MM
    without: tuple[str, ...] = ()
    width: int = 224
    height: int = 172
    recordings: int = 8
    frames: int = 20
    realise: bool = False
    baselines: bool = False
    internals: dict[str, Any] = field(default_factory=dict)
    only: tuple[int, ...] = ()
    hidden: bool = False
    half: int = 0

    @property
    def strength(self) -> float:
        """Return the common strength of all effects, 0 for none."""
        return max(self.effects.values(), default=0.0)

    @property
    def case(self) -> Case:
        """Return the case of the blind camera."""
        return Case(
            SceneKey(
                self.usecase,
                self.scene_seed,
                self.pose_mm,
                self.width,
                self.height,
                self.recordings,
                self.frames,
            ),
            self.effects,
            self.seed,
            internals=Internals(**self.internals),
        )

    @property
    def key(self) -> str:
        """Return a text that is the same for the same case only."""
        return json.dumps(self.to_json(), sort_keys=True)

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {**asdict(self), 'without': list(self.without), 'only': list(self.only)}

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> 'Planned':
        """Read what `to_json` wrote."""
        tuples = {name: tuple(value[name]) for name in ('without', 'only')}
        return cls(**{**value, **tuples})


class _Planner:
    # Gives each case its seeds: the scenes in turn from the low indices of the range, each camera
    # one of the high indices.
    def __init__(
        self, seeds: SeedRange, scene_sets: int, quiet: bool = False, **common: Any
    ) -> None:
        # quiet: a case without an effect shares its scenes with no other. False alarms come from
        # scenes, and many cases in few scenes would say little about them.
        self._seeds, self._scene_sets, self._common = seeds, scene_sets, common
        self._quiet = quiet
        self._used = 0
        self._turns: dict[str, int] = {}

    def plan(self, group: str, usecase: str, effects: dict[str, float], **options: Any) -> Planned:
        turn = self._turns[usecase] = self._turns.get(usecase, -1) + 1
        self._used += 1
        # Other pose errors need other renderings: they share fewer scenes.
        usual = options.get('pose_mm', _USUAL_POSE_MM) == _USUAL_POSE_MM
        scene = turn % (self._scene_sets if usual else _UNUSUAL_SCENE_SETS)
        if self._quiet and group == 'none':
            scene = _SCENE_SETS + self._used
        return Planned(
            group,
            usecase,
            effects,
            self._seeds.seed(1000 + self._used),
            self._seeds.seed(scene),
            **self._common,
            **options,
        )


def make_design(seeds: SeedRange, quick: bool) -> list[Planned]:
    """
    Return all cases.

    `seeds`: all seeds come from it.
    """
    if quick:
        return list(_quick(_Planner(seeds, 2, width=112, height=86, recordings=5, frames=8)))
    return list(_full(_Planner(seeds, _SCENE_SETS, quiet=True), seeds.seed(999_999)))


def _full(planner: _Planner, seed: int) -> Iterator[Planned]:
    rng = np.random.default_rng(seed)
    plan = planner.plan
    names = sorted(CATALOGUE)
    for m, usecase in enumerate(MODES):
        for place, name in enumerate(names):
            turn = (m + place) % 2
            for strength, repeats in STRENGTHS.items():
                for repeat in range(repeats):
                    yield plan(
                        'single',
                        usecase,
                        {name: strength},
                        realise=strength in (0.5, 1.0) and not repeat,
                        baselines=strength == 1.0 and not repeat and not turn,
                        half=repeat if repeats > 1 else turn,
                    )
            yield plan('left_out', usecase, {name: 1.0}, without=(name,), half=turn)
        for i in range(_NONE):
            yield plan('none', usecase, {}, baselines=i < 5, half=i % 2)
        for i in range(_PAIRS):
            one, other = (str(name) for name in rng.choice(names, 2, replace=False))
            yield plan('pair', usecase, {one: 1.0, other: 1.0}, realise=i < 8, half=i % 2)
        for place, name in enumerate(sorted(NOVEL)):
            for repeat in range(_NOVEL_REPEATS):
                looked = not repeat and not (m + place) % 2
                yield plan('novel', usecase, {name: 1.0}, baselines=looked, half=repeat)
    for place, name in enumerate(names):
        for k, pose_mm in enumerate((0.0, 5.0)):
            usecase = MODES[(place + k) % 2]
            half = (place // 2 + k) % 2
            yield plan('single', usecase, {name: 1.0}, pose_mm=pose_mm, half=half)
    for i in range(20):
        yield plan('none', MODES[i % 2], {}, pose_mm=5.0, half=i // 10)
    for i, (name, internals) in enumerate(VARIED):
        yield plan('internals', MODES[i % 2], {name: 1.0}, internals=internals, half=i // 2 % 2)
    for i, name in enumerate(names):
        yield plan('truth', MODES[i % 2], {name: 1.0}, hidden=True, half=i // 2 % 2)
    for i in range(_NONE_HIDDEN):
        yield plan('truth', MODES[i % 2], {}, hidden=True, half=i // 2 % 2)
    yield from _at_once(planner, rng)


def _at_once(planner: _Planner, rng: np.random.Generator) -> Iterator[Planned]:
    # Many effects at once, and effects that some recordings have.
    plan = planner.plan
    sizes = [(count, _SMALL) for count in _COUNTS for _ in range(_MANY)]
    sizes += [(8, {}), (8, {}), (8, _LARGE), (8, _LARGE)]
    for i, (count, size) in enumerate(sizes):
        effects, inside = drawn(rng, count)
        common = {'internals': inside, 'realise': True, 'half': i // 2 % 2, **size}
        yield plan('many', MODES[i % 2], effects, **common)
    for i, name in enumerate(_IN_ONE_SCENE):
        only = (int(rng.integers(8)),)
        yield plan('one_scene', MODES[i % 2], {name: 2.0}, only=only, half=i % 2, **_SMALL)
    for i, name in enumerate(_MIDWAY):
        later = (4, 5, 6, 7)
        yield plan('midway', MODES[i % 2], {name: 1.0}, only=later, half=i % 2, **_SMALL)


def _quick(planner: _Planner) -> Iterator[Planned]:
    plan = planner.plan
    usecase = MODES[0]
    for i, name in enumerate(_QUICK_SINGLES):
        yield plan('single', usecase, {name: 1.0}, realise=not i, baselines=i < 2)
    for i in range(2):
        yield plan('none', usecase, {}, baselines=not i)
    for name in _QUICK_NOVEL:
        yield plan('novel', usecase, {name: 1.0})
    yield plan('pair', usecase, {'wiggling': 1.0, 'temporal_filter': 1.0})
    yield plan('left_out', usecase, {'wiggling': 1.0}, without=('wiggling',))
    yield plan('single', MODES[1], {'fixed_pattern': 1.0})
