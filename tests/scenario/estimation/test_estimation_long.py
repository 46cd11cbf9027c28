"""After 32 pairs: halves are still compared, and noise and the distortion's smoothness are still chosen by the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.elimination.shared_parameters import NOISE
from semlive.estimate.joint.observations.accumulation import DENSE_PAIRS, first_pairs
from semlive.estimate.joint.observations.normal_equations import gradient, marginal
from semlive.estimate.joint.observations.priors import gauge_precision
from semlive.estimate.joint.observations.state import MapObservations
from semlive.estimate.joint.outputs.consistency import FIELD, PAIRS, WARN_SIGMAS, consistency
from semlive.estimate.joint.selection.long_run_choices import reselect_distortion_smoothness, residual_noise_ratio
from semlive.estimate.joint.selection.marginal_likelihood import LocalLikelihood, maximise_evidence
from semlive.estimate.joint.solution.solver import previous_selection
from semlive.estimate.joint.solution.subset import sampled_pair_numbers

COUNT = DENSE_PAIRS + 4
Spoil = Callable[[MapObservations, np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def long_run(world: Callable[..., Any], plans: dict[str, list[Any]]) -> estimating.Solution:
    rng, still = np.random.default_rng(1), plans["short"][0]
    plan = [*plans["short"][:5], *(replace(still, shift_px=tuple(rng.uniform(-28, 28, 2))) for _ in range(COUNT - 5))]
    observed = world(240, step_px=40)
    state = estimating.init(EstimateSettings(), observed.grid, 1024, 884)
    for item in observed.pairs(plan):
        state = estimating.update(state, item.pair, item.step.phase, item.times, item.maps)
    return estimating.solve(state)


def spoilt(solution: estimating.Solution, spoil: Spoil) -> estimating.Solution:
    """As if maps had shown something else: (blocks, 2) px more at the blocks' addresses (blocks, 2)."""
    centre = solution.state.centre_px
    rows = tuple(replace(item, disparity_px=item.disparity_px + spoil(item, item.position_px + centre)) for item in solution.state.rows)
    return replace(solution, state=replace(solution.state, rows=rows))


def test_halves_of_a_sound_long_run_agree(long_run: estimating.Solution) -> None:
    """The distortion's expected difference is a little too large: half of the uncertainty of the drift is counted twice."""
    field, pairs = consistency(long_run)
    assert (field.name, pairs.name) == (FIELD, PAIRS)
    assert abs(field.sigmas) < 3.5
    assert -6.0 < pairs.sigmas < 3.5
    assert field.difference_px == pytest.approx(field.expected_px, rel=0.3)
    assert pairs.difference_px == pytest.approx(pairs.expected_px, rel=0.5)
    assert len(estimating.consistency_notes(long_run)) == 2


def test_the_onset_of_a_sliding_part_of_the_field_is_detected(long_run: estimating.Solution) -> None:
    def slide(rows: MapObservations, at: np.ndarray) -> np.ndarray:
        creep = np.where((at[:, 0] < 470) & (rows.current % 2 == 1), 0.2 * (at[:, 1] - 101) / 600, 0.0)
        return np.stack((np.zeros_like(creep), creep), axis=1)

    field, _ = consistency(spoilt(long_run, slide))
    assert field.sigmas > 10.0
    assert field.sigmas > WARN_SIGMAS


def test_the_onset_of_a_changing_distortion_is_detected(long_run: estimating.Solution) -> None:
    def wave(at: np.ndarray) -> np.ndarray:
        return 0.15 * np.cos(2 * np.pi * at / 300)

    def otherwise(rows: MapObservations, at: np.ndarray) -> np.ndarray:
        if rows.current // 2 % 2 == 0 or rows.within_pair:
            return np.zeros_like(at)
        u = wave(at[:, 0] + rows.disparity_px[:, 0]) - wave(at[:, 0])
        return np.stack((u, np.zeros_like(u)), axis=1)

    field, pairs = consistency(spoilt(long_run, otherwise))
    assert pairs.sigmas > 10.0
    assert field.sigmas < 4.0


def test_noise_that_grows_is_noticed(long_run: estimating.Solution) -> None:
    noise_px = long_run.shared_posterior.step[long_run.shared_posterior.chain.border.part(NOISE)]
    noise_ratio = residual_noise_ratio(long_run.state, long_run.mean, noise_px, DENSE_PAIRS)
    assert noise_ratio == pytest.approx(1.0, abs=0.02)
    rng = np.random.default_rng(3)

    def louder(rows: MapObservations, at: np.ndarray) -> np.ndarray:
        return rng.normal(0, 0.03, at.shape) if rows.current // 2 >= 4 else np.zeros_like(at)

    assert residual_noise_ratio(spoilt(long_run, louder).state, long_run.mean, noise_px, 4) > 1.5


def test_smoothness_from_the_chain_is_that_from_one_matrix(long_run: estimating.Solution) -> None:
    """With everything else integrated out, in two ways."""
    state = first_pairs(long_run.state, 9)
    hyper, near = long_run.hyper, estimating.solve(state).mean
    moved = first_pairs(replace(long_run.state, linearisation_point=np.zeros(0)), 9)
    data = LocalLikelihood(marginal(moved)[0], gradient(moved, near), near)
    dense = maximise_evidence(moved, data, hyper, gauge_precision(moved))
    chosen = reselect_distortion_smoothness(eliminate_all(moved, replace(hyper, rotation_rad=dense.rotation_rad), near))
    assert chosen.distortion == dense.distortion


def test_pairs_that_are_compared_come_in_couples_from_the_stretch_since_the_last_time(long_run: estimating.Solution) -> None:
    assert [previous_selection(n) for n in (2, 33, 48, 49, 64, 1000)] == [1, 32, 32, 48, 48, 768]
    pairs = sampled_pair_numbers(long_run.state, previous_selection(COUNT))
    assert pairs == tuple(range(COUNT - 32, COUNT))
    assert all(two == item + 1 for item, two in zip(pairs[::2], pairs[1::2], strict=True))
