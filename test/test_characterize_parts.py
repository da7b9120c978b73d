"""The parts of the characterization, each against what is known exactly."""

import math
from pathlib import Path

from boards import board
from flexx2_sim_ros.characterize.axial_fit import fit_axial, NAMES
from flexx2_sim_ros.characterize.board_finding import find_board
from flexx2_sim_ros.characterize.conditions import Condition, parse_name
from flexx2_sim_ros.characterize.edge_jitter import (
    edge_positions,
    edge_sigma,
    find_edges,
    measure_edge,
)
from flexx2_sim_ros.characterize.histogram import bin_edges, storage_step
from flexx2_sim_ros.characterize.tiles import gaussian_kl, Tiles
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.modes import flexx2, NoiseModel
from flexx2_sim_ros.recording.opening import find_recordings
import numpy as np
import pytest
from scipy import stats


def test_the_board_is_found_up_to_its_edges():
    target = board(1.2, 30, half_width=0.25, background=2.0)
    truth = np.isfinite(target.incidence)
    noisy = target.depth + 0.003 * np.random.default_rng(3).standard_normal(truth.shape)
    noisy[80:90, 100:120] = np.nan  # a reflection
    found = find_board(noisy, 0.003, target.K)
    assert (found.mask != truth).mean() < 0.002
    assert (found.region <= truth).all()
    # Eight pixels from the left and right edge, none from the image's upper and lower border.
    assert found.region[0].any()
    assert found.region[-1].any()
    assert found.region.sum(axis=1).max() == truth[86].sum() - 16
    u, v = found.aim
    assert (u, v) == tuple(target.K[:2, 2])
    boxed = find_board(noisy, 0.003, target.K, box=(90, 60, 120, 110))
    assert np.array_equal(np.argwhere(boxed.region)[[0, -1]], [[60, 90], [109, 119]])


def test_tiles_that_are_too_steep_are_left_out():
    target = board(0.5, 60)
    found = find_board(target.depth, 0.002, target.K)
    assert np.degrees(target.incidence[found.region]).max() < 70.1
    assert np.degrees(target.incidence[~found.region]).min() > 69.9


@pytest.mark.parametrize('background', [2.2, math.nan])
def test_edges_are_found_and_measured(background):
    """Assert sigma within 3 %: 60 x 156 samples know it to 0.73 %, the rounding included."""
    target = board(1.0, 20, half_width=0.25, background=background)
    generator = np.random.default_rng(7)
    shifts = np.rint(1.2 * generator.standard_normal((60, 172))).astype(int)
    columns = (np.arange(224) - shifts[..., None]) % 224
    clean = np.take_along_axis(target.depth[None].repeat(60, axis=0), columns, axis=2)
    frames = (clean + 0.004 * generator.standard_normal(clean.shape)).astype(np.float32)
    typical = np.median(frames, axis=0)
    found = find_board(typical, 0.002, target.K)
    sites = find_edges(found, typical)
    assert [site.side for site in sites] == ['left', 'right']
    wanted = math.sqrt(1.2**2 + 1 / 12)
    for site in sites:
        edge = measure_edge(edge_positions(frames, site), site)
        assert edge.method == ('outline' if math.isnan(background) else 'gradient')
        assert edge.sigma == pytest.approx(wanted, rel=0.03)
        assert edge.error == pytest.approx(wanted / math.sqrt(2 * 60 * edge.rows), rel=0.1)
        assert abs(edge.kurtosis) < 0.3
        kl = float(gaussian_kl(edge.variance, edge.mean_square, edge.log_variance, wanted))
        assert kl == pytest.approx(edge.floor, rel=0.5)
    # Cut off by the range, it is none.
    assert not find_edges(found, typical, 0.0, 0.9)


@pytest.mark.parametrize(
    ('angle', 'limits', 'masked'),
    [(60, (0.0, 2.3), False), (45, (1.7, 9.0), False), (10, (0.0, 9.0), True)],
)
def test_where_range_or_mask_end_is_no_edge(angle, limits, masked):
    """Assert that neither cuts an edge out of a board that fills the image."""
    target = board(2.0, angle)
    frames = np.repeat(target.depth[None], 40, axis=0)
    frames += 0.004 * np.random.default_rng(1).standard_normal(frames.shape).astype(np.float32)
    v, u = np.indices(target.depth.shape)
    left_in = (u - 0.15 * v > 30) | (not masked)
    frames[(frames < limits[0]) | (frames > limits[1]) | ~left_in] = np.nan
    seen = 2 * np.isfinite(frames).sum(axis=0) > len(frames)
    typical = np.where(seen, np.sort(frames, axis=0)[20], np.nan)
    found = find_board(typical, 0.002, target.K)
    assert not find_edges(found, typical, *limits, left_in)


def procedure_bias(sigma, step, noise):
    """Measure an edge, 4 px off upright, that a Gaussian displaces in every row and frame."""
    generator = np.random.default_rng(0)
    frames, rows, width = 200, 150, 29
    true = width / 2 + np.linspace(-2.0, 2.0, rows)
    true = true + sigma * generator.standard_normal((frames, rows))
    depth = np.where(np.arange(width) > true[..., None], step, 0.0)
    depth = (depth + noise * generator.standard_normal(depth.shape)).astype(np.float32)
    return edge_sigma(depth, slice(0, width))


@pytest.mark.parametrize(
    ('sigma', 'measured'),
    [(0.0, 0.289), (0.3, 0.416), (0.864, 0.911), (1.098, 1.135), (1.649, 1.674)],
)
def test_the_bias_of_the_procedure_is_known(sigma, measured):
    """
    Assert what whole pixels add: 1/12 px^2, when the step is ten times the depth noise.

    200 x 150 samples know sigma to 0.41 %; 3 % is beyond 7 standard errors.
    """
    assert measured == pytest.approx(math.sqrt(sigma**2 + 1 / 12), abs=1e-3)
    assert procedure_bias(sigma, 0.1, 0.01) == pytest.approx(measured, rel=0.03)


def synthetic(noise, distances, angles, generator, scatter=0.0):
    """Draw what recordings of 300 frames would say, each off by its own factor."""
    tiles = []
    for distance in distances:
        for angle in angles:
            z = distance * (1 + 0.1 * generator.uniform(-1, 1, 60))
            theta = np.clip(np.radians(angle) + generator.uniform(-0.15, 0.15, 60), 0, 1.2)
            sigma = noise.sigma_z(z, theta) * (1 + scatter * generator.standard_normal())
            freedom = np.full(60, 16 * 299.0)
            variance = sigma**2 * generator.chisquare(freedom) / freedom
            nothing = np.full(60, math.nan)
            known = z, theta, np.full(60, 16.0), freedom, variance, np.log(variance), 0 * z, 0 * z
            tiles.append(Tiles(*known, nothing, nothing))
    return tiles


MODE_9 = flexx2().mode('Mode_9_30fps').noise
DISTANCES, ANGLES = (0.5, 1.0, 2.0, 3.0, 5.0), (0.0, 20.0, 40.0, 60.0)


def test_standard_errors_have_their_coverage():
    """
    Assert that 95 % intervals cover the truth about that often, recordings being 5 % off.

    Of 60 fits a true 95 % leaves fewer than 44 within once in 1e9; the band is asked at 24 places.
    """
    generator = np.random.default_rng(8)
    z, theta = np.repeat(DISTANCES, 4), np.radians(np.tile(ANGLES, 5))
    hits = dict.fromkeys(NAMES, 0)
    band = []
    for _ in range(60):
        fit = fit_axial(synthetic(MODE_9, DISTANCES, ANGLES, generator, scatter=0.05))
        quantile = stats.t.ppf(0.975, fit.freedom)
        for name in NAMES:
            assert fit.errors[name] is not None
            half = quantile * fit.errors[name] + (0.05 if name == 'n' else 0.0)
            hits[name] += abs(fit.coefficients[name] - getattr(MODE_9, name)) <= half
        error = np.abs(fit.model().sigma_z(z, theta) - MODE_9.sigma_z(z, theta))
        band.append(np.mean(error <= fit.band(z, theta)))
    assert min(hits.values()) >= 44
    assert 0.85 < np.mean(band) <= 1.0


@pytest.mark.parametrize(
    ('distances', 'angles', 'held'),
    [
        ((1.0,), (0.0,), 'bcdn'),
        ((1.0, 2.0), (0.0,), 'cdn'),
        ((1.0, 1.5, 2.0), (0.0,), 'dn'),
        ((1.0,), ANGLES, 'bcn'),
        ((1.0, 2.0), ANGLES, 'c'),
    ],
)
def test_undetermined_coefficients_stay_fixed_and_are_reported(distances, angles, held):
    fit = fit_axial(synthetic(MODE_9, distances, angles, np.random.default_rng(10)))
    for name in held:
        assert fit.errors[name] is None
        assert fit.coefficients[name] == (2.7 if name == 'n' else 0.0)
        assert any(name in note.partition(':')[0] or f'{name} at' in note for note in fit.notes)
    z, theta = np.array([distances[0]]), np.array([0.1])
    assert fit.model().sigma_z(z, theta) == pytest.approx(MODE_9.sigma_z(z, theta), rel=0.3)


def test_noise_that_decreases_with_the_angle_is_reported():
    falling = NoiseModel(0.004, 0.0, 0.001, -0.00002, 2.7, 1.0)
    fit = fit_axial(synthetic(falling, DISTANCES, ANGLES, np.random.default_rng(11)))
    assert fit.coefficients['d'] == 0.0
    assert any('negative' in note for note in fit.notes)


@pytest.mark.parametrize(
    ('name', 'found'),
    [
        ('Mode_9_30fps_1.00m_15deg.npz', Condition('Mode_9_30fps', 1.0, 15.0)),
        ('Mode_9_30fps_1.00m_15deg.mcap', Condition('Mode_9_30fps', 1.0, 15.0)),
        ('Mode_9_30fps_1.00m_15deg', Condition('Mode_9_30fps', 1.0, 15.0)),
        ('a_b_0.5m_7.5deg', Condition('a_b', 0.5, 7.5)),
        ('kinect.npz', None),
        ('1m_2deg', None),
    ],
)
def test_names_state_conditions(name, found):
    assert parse_name(Path(name)) == found
    if found is not None:
        assert parse_name(Path(found.name)) == found


def test_recordings_are_files_and_bags(tmp_path):
    with pytest.raises(InputError, match='must have recordings'):
        find_recordings(tmp_path)
    for name in ('b.npz', 'a.mcap', 'c.db3', 'notes.txt', '.hidden.npz'):
        (tmp_path / name).touch()
    for name, inside in (('bag', 'metadata.yaml'), ('cut', 'cut_0.mcap'), ('other', 'x.txt')):
        (tmp_path / name).mkdir()
        (tmp_path / name / inside).touch()
    found = [path.name for path in find_recordings(tmp_path)]
    assert found == ['a.mcap', 'b.npz', 'bag', 'c.db3', 'cut']
    with pytest.raises(InputError, match='must be a folder'):
        find_recordings(tmp_path / 'b.npz')


def test_a_histogram_of_stored_millimetres_has_no_empty_bins():
    noise = np.random.default_rng(0).normal(0.0, 0.003, 40_000)
    stored = np.round(1.2 + noise, 3).astype(np.float32)
    step = storage_step(stored)
    assert step == pytest.approx(0.001, rel=1e-3)
    counts, edges = np.histogram(stored - 1.2, bin_edges(0.003, step))
    density = counts / counts.sum() / np.diff(edges)
    wanted = stats.norm.pdf((edges[1:] + edges[:-1]) / 2, scale=0.003)
    # 10 % of the peak are 10 standard errors of a bin, and more elsewhere: never by chance.
    assert np.abs(density - wanted).max() < 0.1 * wanted.max()
    fine = bin_edges(0.003, storage_step(1.2 + noise))
    assert len(fine) == 101
    assert fine[-1] == pytest.approx(0.015)
