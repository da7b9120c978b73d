"""
The expected information of one more recording.

Each explanation in turn is assumed to be true. Its shift of the features, noise, and errors of the
ground truth make a gap, with common random numbers for all explanations. The loss of each
explanation on this gap, with the recording's own errors fitted as in the diagnosis, gives its
probability after the recording.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.gap.features.catalogue import Candidate, CandidateTerm, Column
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.inference.fitting import fit
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.planning.power import noise, wrong_truth
import numpy as np
from scipy.special import log_softmax

_DRAWS = 3
_TRUE = 'true: '


class Outlook(NamedTuple):
    """
    What a recording tells about explanations.

    Attributes
    ----------
    bits : float
        Expected information about the true explanation; see `information`.
    told_apart : tuple of int
        The two explanations that it distinguishes best.

    """

    bits: float
    told_apart: tuple[int, int]


def with_true(fitted: Evidence, true: Evidence) -> Evidence:
    """Return a summary with the columns of both summaries, which have different random numbers."""
    return replace(fitted, columns=np.concatenate([fitted.columns, true.columns]))


def true_columns(columns: Sequence[Column]) -> list[Column]:
    """Return the columns of explanations that are assumed to be true."""
    return [replace(column, name=_TRUE + column.name) for column in columns]


def outlook(
    evidence: Evidence,
    columns: Sequence[Column],
    names: Sequence[str | None],
    weights: np.ndarray,
    prior: np.ndarray,
    fitted: bool,
    seed: int,
) -> Outlook:
    """
    Return what a recording tells about explanations.

    Parameters
    ----------
    evidence : Evidence
        The recording, as from `with_true`.
    columns : sequence of Column
        Columns of the evidence: nuisances, explanations, and the explanations of `true_columns`.
    names : sequence of str or None
        (N,) column of each explanation; None for no effect.
    weights : numpy.ndarray
        (N,) probabilities of the explanations before the recording.
    prior : numpy.ndarray
        (6,) standard deviations of pose errors, metres and degrees.
    fitted : bool
        Whether planes are fitted to the recording.
    seed : int
        Seed of the draws.

    """
    model = Model([evidence], columns, prior)
    losses = np.array(
        [
            _losses(model, names, name, fitted, seed, draw)
            for name in names
            for draw in range(_DRAWS)
        ]
    ).reshape(len(names), _DRAWS, len(names))
    apart = losses.mean(axis=1)
    apart = (apart - np.diag(apart)[:, None]) * np.outer(weights, weights)
    i, j = np.unravel_index(int((apart + apart.T).argmax()), apart.shape)
    return Outlook(information(losses, weights), (int(min(i, j)), int(max(i, j))))


def entropy(weights: np.ndarray) -> float:
    """Return the entropy of probabilities in bits."""
    some = weights[weights > 0]
    return float(-(some * np.log2(some)).sum())


def information(losses: np.ndarray, weights: np.ndarray) -> float:
    """
    Return the expected information of a recording about explanations, in bits.

    The expected reduction of the entropy over explanations (Lindley, Ann. Math. Statist. 27, 986,
    1956). exp(-loss / 2) stands for the likelihood. Because that is an approximation, the result
    is the lower bound of Barber and Agakov (NIPS 2003), which holds for any: the entropy before
    the recording plus the mean logarithm of what is believed of the true explanation after it.

    Parameters
    ----------
    losses : numpy.ndarray
        (N, draws, N) loss of each explanation (last axis) when another one is true (first axis).
    weights : numpy.ndarray
        (N,) probabilities of the explanations before the recording.

    """
    before = np.log(np.maximum(weights, np.finfo(float).tiny))
    believed = log_softmax(before - losses / 2, axis=-1)
    after = np.einsum('idi->id', believed).mean(axis=1) / np.log(2)
    return max(entropy(weights) + float(weights @ after), 0.0)


def _losses(
    model: Model, names: Sequence[str | None], true: str | None, fitted: bool, seed: int, draw: int
) -> list[float]:
    # (N,) loss of each explanation when one of them is true.
    rng = np.random.default_rng([seed, draw])
    gap = noise(model, rng) + wrong_truth(model, fitted, rng)
    if true is not None:
        gap = gap + model.column(_TRUE + true)
    seen = model.as_if(gap)
    return [_loss(seen, name) for name in names]


def _loss(model: Model, name: str | None) -> float:
    if name is None:
        return fit(model, [], scales=GROUND_TRUTH.scales).inside
    as_it_is = CandidateTerm(name, ((1.0, name),), 1.0, 1.0)
    one = Candidate(name, '', (as_it_is,), lambda values: {})
    return fit(model, [one], np.ones(1), GROUND_TRUTH.scales).inside
