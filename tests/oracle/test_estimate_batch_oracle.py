"""The incremental information form against one dense least squares over all rows, noise of frame 0 as explicit unknowns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from semlive import estimate as estimating
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.observations.design_columns import map_columns
from semlive.estimate.joint.observations.normal_equations import marginal, relinearise
from semlive.estimate.joint.observations.priors import GAUGE_PX, Hyperparameters, gauge_precision, prior_precision
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.estimate.joint.solution.posterior import posterior
from semlive.model import UniformSpline

GRID = Grid(40, 40, 20, 10, 8, 43)
PHASES = (Phase.CALIBRATION, Phase.CALIBRATION, Phase.TRANSLATION, Phase.TENSION)


def when(frame: int, start_s: float, scans: int = 1) -> FrameTime:
    def from_config(value: float) -> Sourced[float]:
        return Sourced(value, Provenance.CONFIG)

    return FrameTime(frame, start_s, ScanTiming(from_config(1e-4), from_config(0.05), from_config(12.0), Sourced(scans, Provenance.CONFIG)))


def random_map(rng: np.random.Generator, reference: int, current: int, masked: float = 0.1) -> DisparityMap:
    u, v = rng.normal(0, 8) + rng.normal(0, 0.02, GRID.shape), rng.normal(0, 8) + rng.normal(0, 0.02, GRID.shape)
    status = np.where(rng.random(GRID.shape) < masked, PoiStatus.LOW_ZNCC, PoiStatus.CONVERGED).astype(np.uint8)
    sigma = rng.uniform(0.01, 0.03, GRID.shape)
    return DisparityMap(reference, current, GRID, u, v, sigma, 1.3 * sigma, np.ones(GRID.shape), status)


def accumulated(scans: int = 1) -> EstimatorState:
    rng = np.random.default_rng(7)
    state = estimating.init(EstimateSettings(drift_knots_per_frame=1.0, distortion_knot_px=80.0), GRID, 280, 240)
    for pair, phase in enumerate(PHASES):
        n, start_s = 2 * pair, 60.0 * scans * pair
        maps = [random_map(rng, n, n + 1)] + ([random_map(rng, 0, n), random_map(rng, 0, n + 1)] if pair else [])
        state = estimating.update(state, pair, phase, (when(n, start_s, scans), when(n + 1, start_s + 14.0 * scans, scans)), tuple(maps))
    return state


def prior_roots(state: EstimatorState) -> Iterator[tuple[slice, np.ndarray]]:
    """Square roots of gauges and beliefs one by one: a root of their sum, which spans 14 decades, would lose the small ones."""
    assert state.drift is not None
    gauges = {"distortion": state.distortion.affine_rows(GRID) / GAUGE_PX, "drift": state.drift.rows([0.0]) / GAUGE_PX}
    belief = prior_precision(state, Hyperparameters())
    for name in state.layout.names:
        part = state.layout.part(name)
        for axis in (0, 1) if name in gauges else ():
            item = slice(part.start + axis, part.stop, 2)
            yield item, gauges[name]
            value, vector = np.linalg.eigh(belief[item, item])
            yield item, (vector * np.sqrt(np.where(value > 1e-13 * value[-1], value, 0.0))).T
    for change in state.raster:
        part = state.layout.part(change.name)
        yield part, np.linalg.cholesky((gauge_precision(state) + belief)[part, part]).T
    for name in ("axes", "motion"):
        part = state.layout.part(name)
        yield part, np.diag(np.sqrt(np.diag(gauge_precision(state) + belief)[part]))


def dense(state: EstimatorState) -> np.ndarray:
    """Least squares over [parameters, noise of frame 0 per block and component] by QR of all weighted rows."""
    n, blocks = state.layout.size, state.blocks.size
    rows, values = [], []
    for item in state.rows:
        for axis, (index, design) in enumerate(map_columns(state, item, state.linearisation_point)):
            block = np.zeros((blocks, n + 2 * blocks))
            block[:, index] = design
            if item.reference == 0:
                block[:, n + axis * blocks : n + (axis + 1) * blocks] = -np.eye(blocks)
            root = np.sqrt(item.weight[:, axis])
            rows.append(block * root[:, None])
            values.append(item.disparity_px[:, axis] * root)
    noise_prior = np.zeros((2 * blocks, n + 2 * blocks))
    noise_prior[:, n:] = np.diag(np.sqrt(state.reference.prior.T.ravel()))
    rows.append(noise_prior)
    values.append(np.zeros(2 * blocks))
    for part, item in prior_roots(state):
        root = np.zeros((len(item), n + 2 * blocks))
        root[:, part] = item
        rows.append(root)
        values.append(np.zeros(len(item)))
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=1e-15)[0][:n]


@pytest.mark.parametrize("scans", [1, 7])
def test_updates_equal_one_dense_least_squares(scans: int) -> None:
    state = accumulated(scans)
    prior = gauge_precision(state) + prior_precision(state, Hyperparameters())
    mean, _ = posterior(marginal(state), prior, 1.0)
    expected = dense(state)
    for name in state.layout.names:
        part = state.layout.part(name)
        assert np.abs(mean[part] - expected[part]).max(initial=0.0) <= 1e-8 * np.abs(expected[part]).max(initial=0.0) + 1e-12, name


def test_relinearised_sums_equal_sums_about_the_same_point() -> None:
    """Re-linearising touches only the motions' rows and columns; summing everything again must give the same."""
    state = accumulated()
    about = np.random.default_rng(3).normal(size=state.layout.size)
    quick = relinearise(state, about)
    twice = relinearise(relinearise(state, 2 * about), about)
    prior = gauge_precision(state) + prior_precision(state, Hyperparameters())
    np.testing.assert_allclose(posterior(marginal(quick), prior, 1.0)[0], dense(quick), rtol=0, atol=1e-7)
    np.testing.assert_allclose(quick.precision, twice.precision, rtol=1e-12)
    assert not np.allclose(quick.precision, state.precision)


def test_update_does_not_change_the_old_state() -> None:
    state = accumulated()
    before = state.precision.copy(), state.information.copy(), state.reference.coupling.copy()
    rng = np.random.default_rng(1)
    times = (when(8, 900.0), when(9, 914.0))
    estimating.update(state, 4, Phase.TENSION, times, (random_map(rng, 8, 9), random_map(rng, 0, 8), random_map(rng, 0, 9)))
    for old, now in zip(before, (state.precision, state.information, state.reference.coupling), strict=True):
        np.testing.assert_array_equal(old, now)


def test_gross_errors_of_single_points_are_excluded() -> None:
    grid = replace(GRID, step_px=5, nx=40, ny=32)
    rng = np.random.default_rng(5)
    clean = rng.normal(3.0, 0.02, grid.shape) + 0.01 * np.arange(grid.nx)
    spoilt = clean.copy()
    spoilt[3, 4], spoilt[20, 30] = 25.0, -8.0
    means = []
    for u in (clean, spoilt):
        item, none = np.full(grid.shape, 0.02), np.zeros(grid.shape, np.uint8)
        dmap = DisparityMap(0, 1, grid, u.copy(), u.copy(), item, item, item, none)
        state = estimating.init(EstimateSettings(), grid, 280, 240)
        state = estimating.update(state, 0, Phase.CALIBRATION, (when(0, 0.0), when(1, 14.0)), (dmap,))
        means.append(state.rows[0].disparity_px)
    assert np.abs(means[0] - means[1]).max() < 0.002


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("derivative", [0, 1])
def test_spline_rows_equal_scipy(derivative: int, degree: int) -> None:
    spline = UniformSpline(2.0, 7.5, 6, degree)
    at = np.linspace(2.0, 47.0 - 1e-9, 301)
    knots = 2.0 + 7.5 * np.arange(-degree, 6 + degree + 1)
    index, value = spline.local(at) if derivative == 0 else spline.local_rate(at)
    rows = np.zeros((len(at), spline.size))
    np.put_along_axis(rows, index, value, axis=1)
    expected = np.stack([BSpline(knots, item, degree)(at, derivative) for item in np.eye(spline.size)], axis=1)
    np.testing.assert_allclose(rows, expected, atol=1e-12)
    if derivative == 0:
        np.testing.assert_allclose(rows, BSpline.design_matrix(at, knots, degree).toarray(), atol=1e-12)


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("order", [2, 3, 4])
def test_roughness_frees_polynomials_below_its_order_and_nothing_else(degree: int, order: int) -> None:
    spline = UniformSpline(1.0, 2.0, 9, degree)
    at = np.linspace(1.0, 19.0, 200)
    rows = np.zeros((len(at), spline.size))
    np.put_along_axis(rows, *spline.local(at), axis=1)
    penalty = spline.roughness(order)
    assert np.linalg.matrix_rank(penalty) == spline.size - order
    for power in range(order + 1 if order <= degree else order):
        coefficients = np.linalg.lstsq(rows, at**power, rcond=None)[0]
        if power <= degree:
            np.testing.assert_allclose(rows @ coefficients, at**power, rtol=1e-8)
        cost = coefficients @ penalty @ coefficients
        assert (cost < 1e-9 * (coefficients @ coefficients)) == (power < order)
