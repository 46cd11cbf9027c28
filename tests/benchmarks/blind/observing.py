"""From a hidden experiment to what diagnosis is given: through the estimator's public doors, like any log."""

from __future__ import annotations

from dataclasses import replace

from blind.experiment import GRID, Conditions, hidden
from numexp.world import HEIGHT_PX, WIDTH_PX

from semlive import estimate
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.diagnose.baseline.observation import Observation, StepConditions, baseline_solution, make_observation
from semlive_simulators.effects.interfaces import Effect

QUICK = EstimateSettings(drift_knots_per_frame=1.0, distortion_knot_px=200.0)
"""For tests: half of the parameters, which takes a tenth of the time. The drift is quadratic; the distortion is a quadratic surface and
a wave as long as the frame."""


def observed(
    conditions: Conditions, effects: tuple[Effect, ...], grid: Grid = GRID, settings: EstimateSettings | None = None
) -> Observation:
    """An experiment with effects in it, estimated without them."""
    pairs = hidden(conditions, effects, grid)
    state = estimate.init(settings or EstimateSettings(), grid, WIDTH_PX, HEIGHT_PX)
    for one in pairs:
        state = estimate.update(state, one.pose.pair, one.pose.phase, one.times, one.maps)
    steps = [StepConditions(one.pose.pair, one.pose.phase, (one.pose.load_n, one.pose.load_n), one.pose.commanded_px) for one in pairs]
    solution, other = baseline_solution(state)
    return replace(make_observation(solution, steps, other), pixel_um=conditions.scan.pixel_size_um)
