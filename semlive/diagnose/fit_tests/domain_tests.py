"""Tests of model misfit: one calibrated test for each domain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import DomainTest
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import NullDraws, projected_with_draws
from semlive.diagnose.baseline.noise_scale import modes
from semlive.model.effects import RunGeometry

Array = NDArray[np.float64]
ROWS = 8  # order of the polynomials over rows
MIN_RELATIVE_EIGENVALUE = 1e-3  # relative to the largest: below it, the baseline absorbs almost all of a contrast


def run_domain_tests(baseline: HyperparameterGrid, draws: NullDraws) -> tuple[DomainTest, ...]:
    """Test each domain, with family-wise p-values over all domains (Westfall and Young: smallest p-value of each draw)."""
    scene = baseline.design.observation.geometry
    tests = []
    for domain, field in domain_contrasts(scene):
        values, gradient, samples = projected_with_draws(baseline, field, draws)
        observed = values > MIN_RELATIVE_EIGENVALUE * values[-1]
        statistic = float(np.sum(gradient[observed] ** 2 / values[observed]))
        null = np.sum(samples[:, observed] ** 2 / values[observed], axis=1)
        tests.append((domain, statistic, null, int(observed.sum())))
    ranks = np.stack([_upper(null, null) for _, _, null, _ in tests])
    least = ranks.min(axis=0)
    f, b, _ = baseline.whitened_residual.shape
    results = []
    for domain, statistic, null, count in tests:
        own = float(_upper(null, np.array([statistic]))[0])
        p_value = (1.0 + float(np.sum(least <= own))) / (1.0 + len(least))
        rms_px = baseline.design.whiten.sigma_px * float(np.sqrt(max(statistic - count, 0.0) / (2 * f * b)))
        results.append(DomainTest(domain, p_value, rms_px))
    return tuple(results)


def _upper(null: Array, value: Array) -> Array:
    """(n,) fraction of null draws at least as large as the values (n,)."""
    below = np.searchsorted(np.sort(null), value, side="left")
    return np.asarray((1.0 + len(null) - below) / (1.0 + len(null)), dtype=np.float64)


def domain_contrasts(scene: RunGeometry) -> list[tuple[str, Array]]:
    """Contrast fields as pairs of a domain and (f, b, 2, q) fields."""
    relative_time = np.broadcast_to((scene.time_s / scene.end_s), scene.time_s.shape)
    frames = np.eye(len(scene.frame))[:, None, :] * np.ones((1, scene.time_s.shape[1], 1))
    row = np.polynomial.legendre.legvander(scene.time_in_frame_s / float(scene.time_in_frame_s.max()) * 2.0 - 1.0, ROWS)[..., 1:]
    low = scene.address_px.min(axis=(0, 1))
    first = np.moveaxis((scene.address_px - low < 60.0).astype(np.float64), -1, 0)
    coarse = modes(scene, 2)
    contrasts = [
        ("space", _both_axes(modes(scene) * relative_time[..., None])),
        ("row", _both_axes(row * relative_time[..., None])),
        ("row_start", _both_axes(np.stack((first[0] * relative_time, first[1] * relative_time), axis=-1))),
        ("scan_time", _both_axes((frames[..., None] * row[:, :, None, :2]).reshape(*relative_time.shape, -1))),
        ("frame", _both_axes((frames[..., None] * coarse[:, :, None, 1:]).reshape(*relative_time.shape, -1))),
        ("fraction", fraction_waves(scene)),
    ]
    if scene.load.any():
        contrasts.append(("load", _both_axes(modes(scene) * np.broadcast_to(scene.load, relative_time.shape)[..., None])))
    return contrasts


def fraction_waves(scene: RunGeometry) -> Array:
    """(f, b, 2, 4) sine and cosine of the fraction of a pixel, separately along x and y; in a composed map of both parts."""
    fraction = 2.0 * np.pi * scene.measured_parts_px
    return np.concatenate([_component_columns(value.sum(axis=0)) for value in (np.sin(fraction), np.cos(fraction))], axis=-1)


def _both_axes(shapes: Array) -> Array:
    """(f, b, 2, 2 q) shapes (f, b, q) along x and along y."""
    columns = np.zeros((*shapes.shape[:-1], 2, shapes.shape[-1], 2))
    columns[..., 0, :, 0] = columns[..., 1, :, 1] = shapes
    return columns.reshape(*columns.shape[:-2], -1)


def _component_columns(field: Array) -> Array:
    """(f, b, 2, 2) the two components of a field as separate columns."""
    columns = np.zeros((*field.shape, 2))
    columns[..., 0, 0], columns[..., 1, 1] = field[..., 0], field[..., 1]
    return columns
