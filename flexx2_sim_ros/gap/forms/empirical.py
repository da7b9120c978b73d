"""An empirical correction: what is left over one covariate, without a cause."""

from collections.abc import Sequence
from dataclasses import dataclass

from flexx2_sim_ros.effects.patch import COVARIATES, ResidualPatch, SLOTS
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.data.axes import AXES, Axes
from flexx2_sim_ros.gap.features.physical import Measures, SURFACES
from flexx2_sim_ros.gap.forms.bias import Form
from flexx2_sim_ros.gap.forms.fitting import BiasFit
from flexx2_sim_ros.gap.forms.samples import Samples
import numpy as np

NAME = ResidualPatch.name


@dataclass(frozen=True)
class Rest:
    """
    What effects leave in a recording.

    Attributes
    ----------
    samples : Samples
        Errors on surfaces, less what the effects change.
    edges : dict of str to tuple of float
        Limits of the bins of each covariate.
    real, simulated : Measures
        Of the recording and of its simulation with the effects.

    """

    samples: Samples
    edges: dict[str, tuple[float, ...]]
    real: Measures
    simulated: Measures


def edges_of(axes: Axes) -> dict[str, tuple[float, ...]]:
    """Return the limits of the bins of each covariate that a correction can be over."""
    return {name: axes[name].edges for name in COVARIATES}


def correction(covariate: str, rests: Sequence[Rest]) -> dict[str, float]:
    """
    Return the settings of a correction over a covariate.

    The bias is fitted together with the poses of the recordings; noise and loss are the ratio and
    the difference of recording and simulation.

    Parameters
    ----------
    covariate : str
        One of `effects.patch.COVARIATES`.
    rests : sequence of Rest
        Of the recordings that it is fitted to.

    """
    edges = rests[0].edges[covariate]
    bias = _bias(binned(covariate, edges), [one.samples for one in rests])
    place = [name for name in SURFACES for _ in range(AXES[name].bins)]
    mine = np.array([name == covariate for name in place])
    ratio = _mean([(one.real.noise, one.simulated.noise) for one in rests], mine)
    seen = np.sum([one.real.invalid[:, : len(mine)][:, mine] for one in rests], axis=0)
    lost = np.sum([one.simulated.invalid[:, : len(mine)][:, mine] for one in rests], axis=0)
    rates = [one[1] / np.maximum(one[0], 1) for one in (seen, lost)]
    more = np.clip((rates[0] - rates[1]) / np.maximum(1 - rates[1], 1e-3), 0, 1)
    more[seen[0] < FORMS.known] = 0.0
    out = {'strength': 1.0, 'covariate_index': float(COVARIATES.index(covariate))}
    out |= {f'edge_{i}': float(edge) for i, edge in enumerate(edges)}
    for i in range(min(len(bias), SLOTS)):
        out[f'bias_{i}'] = float(np.clip(np.round(bias[i], 6), -1, 1))
        out[f'scale_{i}'] = float(np.clip(np.round(np.exp(ratio[i] / 2), 4), 0.1, 10))
        out[f'loss_{i}'] = float(np.round(more[i], 5))
    return out


def _bias(form: 'Binned', samples: Sequence[Samples]) -> np.ndarray:
    # (K,) metres. Poses look like a constant, so the mean over all samples is held at 0.
    fitted = BiasFit(samples).fit([form]).together
    count = sum(form.columns(one).sum(axis=1) for one in samples)
    known = np.asarray(count) >= FORMS.known
    if not known.any():
        return np.zeros(len(fitted))
    mean = np.average(fitted[known], weights=np.asarray(count)[known])
    return np.where(known, fitted - mean, 0.0)


def _mean(pairs: Sequence[tuple[np.ndarray, np.ndarray]], mine: np.ndarray) -> np.ndarray:
    # Mean difference of the log variance in each bin, by the number of pixels; 0 if unknown.
    total, weight = np.zeros(int(mine.sum())), np.zeros(int(mine.sum()))
    for real, simulated in pairs:
        with np.errstate(invalid='ignore'):  # -inf where nothing varies
            count, difference = real[0][mine], (real[1] - simulated[1])[mine]
        good = np.isfinite(difference) & (count >= FORMS.known)
        total[good] += count[good] * difference[good]
        weight[good] += count[good]
    return np.asarray(total / np.maximum(weight, 1))


@dataclass(frozen=True)
class Binned(Form):
    """A bias of the depth, constant in each bin of a covariate; its name is the label."""

    def columns(self, samples: Samples) -> np.ndarray:
        """Return (K, N) metres of depth for a coefficient of 1 each."""
        if self.label == 'distance':
            return self.basis(samples.distance / samples.length)
        return self.basis(samples.light if self.label == 'log_amplitude' else samples.incidence)


def binned(covariate: str, edges: tuple[float, ...]) -> Binned:
    """Return a bias that is constant in each bin of a covariate."""
    units = np.eye(len(edges) + 1)

    def basis(x: np.ndarray) -> np.ndarray:
        return np.asarray(units[:, np.searchsorted(edges, x)])

    return Binned(NAME, covariate, basis, np.array(edges))
