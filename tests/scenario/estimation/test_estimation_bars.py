"""Drift, distortion, strain and elastic constants against a world written apart from the estimator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive import mechanics
from semlive.data.drift import EstimateRevision
from semlive.data.experiment import Phase
from semlive.data.settings import EstimateSettings
from semlive.data.strain import ElasticConstants

YOUNGS_GPA, POISSON, AREA_MM2 = 71.1, 0.33, 10.0


@dataclass(frozen=True)
class Outcome:
    estimate: EstimateRevision
    elastic: ElasticConstants
    drift_error_px: np.ndarray  # (frames, samples, 2), the frame's mean removed
    drift_z: np.ndarray  # change from the middle of a frame to its ends, in sigmas
    distortion_error_px: np.ndarray  # (ny, nx, 2), best affine map removed
    strain_error: np.ndarray  # (frames, 3)
    strain_z: np.ndarray
    unloaded: np.ndarray  # (frames,) bool


def run(world: Any, steps: list[Any]) -> Outcome:
    state = estimating.init(EstimateSettings(), world.grid, 1024, 884)
    taken = list(world.pairs(steps))
    for item in taken:
        state = estimating.update(state, item.pair, item.step.phase, item.times, item.maps)
    solution = estimating.solve(state)
    found = estimating.to_estimate(solution, 0)
    error, sigma, unloaded, points, frames = [], [], [], [], []
    for item in taken:
        for dmap in (dmap for dmap in item.maps if dmap.reference == 0):
            moved = mechanics.displacement(dmap, estimating.correction(solution, dmap))
            systematic = estimating.correction_strain_sigma(solution, dmap)
            printed = mechanics.summary(moved, mechanics.strain(moved, 5), found.noise_floor_px, systematic)
            g = item.gradient
            error.append([printed.mean.exx - g[0, 0], printed.mean.eyy - g[1, 1], printed.mean.exy - 0.5 * (g[0, 1] + g[1, 0])])
            sigma.append([printed.mean_sigma.exx, printed.mean_sigma.eyy, printed.mean_sigma.exy])
            unloaded.append(item.step.strain == 0.0)
            if item.step.phase is Phase.TENSION:
                points.append((item.step.strain * YOUNGS_GPA * 1e3 * AREA_MM2, printed))
                frames.append(dmap.current)
    shared = estimating.mean_strain_covariance(solution, frames)
    elastic = mechanics.elastic_constants(points, AREA_MM2, "y", covariance=shared)
    samples = found.drift.drift_px - world.drift(found.drift.time_s)
    by_frame = samples.reshape(len(state.frames), -1, 2)
    middle = 0.5 * (by_frame[:, 5] + by_frame[:, 6])
    z = (by_frame - middle[:, None])[:, [0, -1]] / found.drift.sigma_px.reshape(by_frame.shape)[:, [0, -1]]
    return Outcome(
        found, elastic, by_frame - by_frame.mean(axis=1, keepdims=True), z, affine_removed(world, found),
        np.array(error), np.array(error) / np.array(sigma), np.array(unloaded),
    )  # fmt: skip


def affine_removed(world: Any, found: EstimateRevision) -> np.ndarray:
    x, y = world.grid.mesh()
    error = np.stack((found.distortion.ex_px, found.distortion.ey_px), axis=-1) - world.distortion(np.stack((x, y), axis=-1))
    plane = np.column_stack((np.ones(x.size), x.ravel(), y.ravel()))
    flat = error.reshape(-1, 2)
    return (flat - plane @ np.linalg.lstsq(plane, flat, rcond=None)[0]).reshape(error.shape)


@pytest.fixture(scope="module")
def full(world: Callable[..., Any], plans: dict[str, list[Any]]) -> Outcome:
    return run(world(1, step_px=10), plans["full"])


def test_drift_within_each_frame_is_right(full: Outcome) -> None:
    """The bar is 0.02 px rms over the rows of each frame; without noise 6e-5 px are left, with noise 0.002 px."""
    assert np.sqrt((full.drift_error_px**2).mean(axis=1)).max() <= 0.005


def test_unloaded_frames_show_no_strain(full: Outcome) -> None:
    """The bar is 3e-5; the DIC noise of one map alone is 7e-6 (0.02 px, 272 independent points)."""
    assert np.abs(full.strain_error[full.unloaded]).max() <= 3e-5


def test_distortion_is_right(full: Outcome) -> None:
    assert np.abs(full.distortion_error_px).max() <= 0.03
    assert full.estimate.distortion.valid.all()


def test_elastic_constants_are_right(full: Outcome) -> None:
    assert full.elastic.youngs_modulus_gpa.value == pytest.approx(YOUNGS_GPA, rel=0.01)
    assert full.elastic.poissons_ratio.value == pytest.approx(POISSON, abs=0.01)


def test_noise_floor_is_the_noise(full: Outcome) -> None:
    assert full.estimate.noise_floor_px == pytest.approx(0.02, rel=0.1)


def test_without_noise_nothing_but_the_spline_is_left(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Distortion with 100 px knots has a residual of 8e-4 px in waves of 650 px; it hardly changes the mean strain."""
    exact = run(world(1, noise_px=0.0), plans["full"])
    assert np.abs(exact.distortion_error_px).max() <= 0.003
    assert np.abs(exact.drift_error_px).max() <= 3e-4
    assert np.abs(exact.strain_error[exact.unloaded]).max() <= 1e-6
    assert exact.elastic.youngs_modulus_gpa.value == pytest.approx(YOUNGS_GPA, rel=1e-3)


def test_short_run_and_coverage(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Over seeds of the short plan: bars hold in each, and errors are as large as the stated sigmas (more in the coverage tests)."""
    many = [run(world(seed), plans["short"]) for seed in range(100, 106)]
    youngs = [item.elastic.youngs_modulus_gpa for item in many]
    assert max(abs(item.elastic.poissons_ratio.value - POISSON) for item in many) <= 0.02
    assert max(abs(item.value / YOUNGS_GPA - 1) for item in youngs) <= 0.03
    assert max(np.sqrt((item.drift_error_px**2).mean(axis=1)).max() for item in many) <= 0.02
    assert max(np.abs(item.strain_error[item.unloaded]).max() for item in many) <= 3e-5
    z = {
        "drift": np.concatenate([item.drift_z.ravel() for item in many]),
        "distortion": np.concatenate([(item.distortion_error_px / item.estimate.distortion.sigma_px[..., None]).ravel() for item in many]),
        "strain": np.concatenate([item.strain_z.ravel() for item in many]),
    }
    rms = {name: float(np.sqrt(np.mean(item**2))) for name, item in z.items()}
    assert all(0.6 <= item <= 1.5 for item in rms.values()), rms
