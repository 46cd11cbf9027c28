"""A score reports wrong uncertainties, and only those."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.errors import BadInput
from semlive.report.noise_propagation import noise_scatter
from semlive.report.scoring.errors import DistortionError, DriftWithin, FrameErrors, RunErrors, ShiftError
from semlive.report.scoring.figures import save_figures
from semlive.report.scoring.score import Score, independent_samples, scores_of
from semlive.report.scoring.truth import average_over_subset

GRID = Grid(20, 20, 10, 40, 30, 10)
FRAMES = 24


def drawn(seed: int, stated: float = 1.0) -> RunErrors:
    """Errors of a run whose true uncertainties are known; it states `stated` times as much."""
    rng = np.random.default_rng(seed)
    ny, nx = GRID.shape
    ramp = np.linspace(-1, 1, 12)[:, None]
    drift = tuple(
        DriftWithin(
            n, 100.0 * n + np.arange(12.0), np.zeros((12, 2)), 1e-3 * ramp * rng.normal(size=2), stated * 1e-3 * np.abs(ramp * [1, 1])
        )
        for n in range(FRAMES)
    )
    all_valid = np.ones((ny, nx), dtype=bool)
    distortion = DistortionError(GRID, 0.003 * rng.normal(size=(ny, nx, 2)), np.full((ny, nx), 0.003 * stated), all_valid, np.zeros((2, 2)))
    shifts = tuple(ShiftError(n, np.zeros(2), 0.01 * rng.normal(size=2), np.full(2, 0.01 * stated)) for n in range(1, 12))
    scatter = noise_scatter(GRID, 5, 0.02, 0.02, full=False)
    frames = tuple(
        FrameErrors(
            n, Phase.CALIBRATION if n < 14 else Phase.TENSION, None, all_valid,
            0.02 * rng.normal(size=(ny, nx, 2)), np.full((ny, nx, 2), 0.02 * stated),
            np.zeros(3), 5e-6 * rng.normal(size=3), np.full(3, 5e-6 * stated),
            np.array([scatter.exx, scatter.eyy, scatter.exy]), 5,
        )
        for n in range(1, FRAMES)
    )  # fmt: skip
    return RunErrors(GRID, drift, distortion, shifts, frames, 0.02)


def judged(errors: RunErrors) -> dict[str, Score]:
    return {item.name: item for item in scores_of(errors)}


def test_correct_uncertainties_are_rated_correct() -> None:
    """At 95 % a few of many rows are outside by chance: over seeds no more than that."""
    outside = [not item.covers(0.95) for seed in range(20) for item in scores_of(drawn(seed)) if not item.detail]
    assert np.mean(outside) < 0.08


@pytest.mark.parametrize("name", ["drift within frames", "distortion", "displacement of points", "mean strain of frames"])
@pytest.mark.parametrize("stated", [0.5, 2.0])
def test_wrong_uncertainties_show_as_wrong(name: str, stated: float) -> None:
    printed = judged(drawn(1, stated))
    assert not printed[f"coverage at 68 %, {name}"].covers(0.95)
    assert np.sign(printed[f"coverage at 68 %, {name}"].error) == np.sign(stated - 1)


def test_an_rms_error_larger_than_stated_is_outside() -> None:
    assert not judged(drawn(2, 0.7))["distortion, rms error"].covers(0.95)
    assert not judged(drawn(2, 0.7))["displacement, rms error"].covers(0.95)
    assert not judged(drawn(2, 0.8))["scatter of eyy, calibration, over 50 px"].covers(0.95)


def test_one_value_is_judged_by_the_normal_distribution() -> None:
    assert Score("a", 0.0, 0.999, 1.0, "").covers(0.6827)
    assert not Score("a", 0.0, -1.001, 1.0, "").covers(0.6827)
    assert Score("a", 1.0, 2.959, 1.0, "").covers(0.95)
    assert not Score("a", 1.0, 2.961, 1.0, "").covers(0.95)


def test_an_rms_of_many_is_judged_more_narrowly_and_a_worst_of_many_more_widely() -> None:
    item = Score("rms", 0.0, 1.2, 1.0, "px")
    assert item.covers(0.95)
    assert not replace(item, freedom=100.0).covers(0.95)
    worst = Score("worst", 0.0, 2.8, 1.0, "px")
    assert not worst.covers(0.95)
    assert replace(worst, candidates=50.0).covers(0.95)


def test_independent_values_are_counted_from_the_errors_themselves() -> None:
    rng = np.random.default_rng(3)
    assert independent_samples(rng.normal(size=(30, 40))) == pytest.approx(1200, rel=0.15)
    assert independent_samples(np.full((30, 40), 0.7)) == pytest.approx(1.0)
    smooth = [independent_samples(gaussian_filter(rng.normal(size=(90, 110)), 3.0)[15:-15, 15:-15]) for _ in range(30)]
    # The field's edges count as modes too: 22 % too many here.
    assert np.mean(smooth) == pytest.approx(60 * 80 / (2 * np.pi * 3.0**2), rel=0.35)


def test_the_json_is_finite_and_has_the_documented_keys() -> None:
    for item in judged(drawn(4)).values():
        reported = item.to_json()
        assert list(reported) == ["truth", "value", "sigma", "error", "unit", "inside68", "inside95"]
        json.dumps(reported, allow_nan=False)


def test_figures_go_to_a_folder_or_to_one_sheet(tmp_path: Path) -> None:
    errors = drawn(6)
    assert [path.name for path in save_figures(errors, tmp_path / "f")] == [
        "score-drift.png", "score-distortion.png", "score-strain.png", "score-coverage.png",
    ]  # fmt: skip
    (sheet,) = save_figures(errors, tmp_path / "sheet.svg")
    assert sheet.stat().st_size > 10_000
    (tmp_path / "taken").write_text("")
    with pytest.raises(BadInput, match="can be written"):
        save_figures(errors, tmp_path / "taken")


def test_a_field_is_compared_by_its_mean_over_a_subset() -> None:
    at = np.random.default_rng(3).uniform(-100.0, 100.0, (5, 2))

    def bent(address: np.ndarray) -> np.ndarray:
        x, y = address[..., 0], address[..., 1]
        return np.stack((1.0 + 0.5 * x + 1e-3 * x**2 * y, 2e-4 * y**4), axis=-1)

    x, y, square = at[:, 0], at[:, 1], 43.0**2
    exact = np.stack((1.0 + 0.5 * x + 1e-3 * (x**2 + square / 12) * y, 2e-4 * (y**4 + y**2 * square / 2 + square**2 / 80)), axis=-1)
    assert np.allclose(average_over_subset(bent, at, 43), exact, rtol=1e-9)
    assert np.allclose(average_over_subset(bent, at, 0), bent(at), rtol=1e-12)
