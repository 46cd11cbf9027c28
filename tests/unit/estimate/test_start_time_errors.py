"""Starts of scans that are not known exactly, and the strain that they make uncertain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numexp.asrun import decision_of
from numexp.cases import CASES
from numexp.experiment import make_experiment

from semlive import pipeline
from semlive.data.grid import Grid
from semlive.data.results import FrameResult, RunResult
from semlive.data.scan import Sourced
from semlive.data.settings import AnalysisSettings
from semlive.estimate.sutton.start_times import start_time_strain

EXPERIMENT = make_experiment(CASES["exact"], 4, Grid(101, 101, 30, 25, 20, 43), 3)


def concluded(sigma_s: float, method: str = "joint", seed: int | None = None) -> RunResult:
    rng = None if seed is None else np.random.default_rng(seed)
    started, settings = None, replace(AnalysisSettings(), estimate=replace(AnalysisSettings().estimate, method=method))
    for taken in EXPERIMENT.pairs:
        decision = decision_of(taken, taken.pair, settings)
        first, second = (
            replace(
                info,
                start_sigma_s=sigma_s,
                start_time_ns=Sourced(
                    info.start_time_ns.value + (0 if rng is None else round(rng.normal(0.0, sigma_s) * 1e9)), info.start_time_ns.source
                ),
            )
            for info in (decision.first, decision.second)
        )
        decision = replace(decision, first=first, second=second)
        started = started or pipeline.start_from_maps(settings, first, EXPERIMENT.grid)
        started = pipeline.accumulate(started, decision, taken.maps)
    assert started is not None
    return pipeline.finalise(started)


def test_strain_is_uncertain_by_the_fraction_to_which_the_time_between_starts_is() -> None:
    first, second = (replace(when, start_sigma_s=0.3) for when in EXPERIMENT.pairs[1].times)
    found = start_time_strain((first, second), (2.0, -4.0))
    interval_s = second.start_s - first.start_s
    fraction = 0.3 * 2**0.5 / interval_s
    timing = second.timing
    assert found.eyy == pytest.approx(4.0 / interval_s * timing.row_time_s.value * fraction)
    assert found.exx == pytest.approx(2.0 / interval_s * timing.dwell_time_s.value * fraction)
    assert start_time_strain((second, first), (2.0, -4.0)).eyy == 0.0


@pytest.mark.parametrize("method", ["joint", "sutton2007"])
def test_a_worse_clock_makes_the_stated_strain_less_certain_and_covers_its_error(method: str) -> None:
    sure, unsure = concluded(0.0, method), concluded(0.5, method)
    for one, other in zip(sure.frames[1:], unsure.frames[1:], strict=True):
        assert moved(one, other) < 1e-8
        assert other.summary.mean_sigma.eyy > one.summary.mean_sigma.eyy
    astray = concluded(0.5, method, seed=1)
    for one, other in zip(sure.frames[1:], astray.frames[1:], strict=True):
        assert abs(other.summary.mean.eyy - one.summary.mean.eyy) < 3.0 * other.summary.mean_sigma.eyy


def moved(one: FrameResult, other: FrameResult) -> float:
    """Largest change of a mean strain."""
    means = one.summary.mean, other.summary.mean
    return max(abs(getattr(means[0], name) - getattr(means[1], name)) for name in ("exx", "eyy", "exy"))
