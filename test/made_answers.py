"""Answers of a diagnosis, and small cases of the benchmark, made by hand."""

from study.benchmark import DEVELOPMENT, Planned

MODE = 'Mode_5_30fps'


def said(verdict, effects=(), alternatives=(), **more):
    """Return a diagnosis."""

    def listed(names):
        return [
            {
                'name': name,
                'parameters': {'bias': 0.012},
                'share': 0.5,
                'interval': [0.4, 0.6],
                'takes_off': None,
                'confidence': 0.9,
            }
            for name in names
        ]

    return {
        'schema': 1,
        'verdict': verdict,
        'effects': listed(effects),
        'alternatives': listed(alternatives),
        'unexplained': [],
        'recordings': [],
        'where': [
            {
                'covariate': 'distance',
                'low': 0.0,
                'high': 9.0,
                'unit': 'm',
                'channel': 'bias',
                'size': 1.0,
                'unit_size': 'mm',
                'q_value': 0.01,
            }
        ],
        'gap': {'before': 10.0, 'after': 4.0, 'null': 1.0, 'shrink': 0.6, 'interval': [0.4, 0.8]},
        'seconds': 0.1,
        'peak_mb': 123.0,
        'version': '0',
        **more,
    }


def small(group, effects, seed, **options):
    return Planned(
        group,
        MODE,
        effects,
        DEVELOPMENT.seed(1000 + seed),
        DEVELOPMENT.seed(0),
        width=56,
        height=43,
        recordings=2,
        frames=3,
        **options,
    )
