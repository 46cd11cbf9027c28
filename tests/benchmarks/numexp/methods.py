"""The methods under test, through their public doors."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numexp.experiment import Experiment
from numexp.lens_distortion import fit_lens_distortion
from numexp.measure import Found
from numexp.world import HEIGHT_PX, WIDTH_PX, Field

from semlive import estimate
from semlive.data.disparity import DisparityMap
from semlive.data.drift import Correction, DistortionField
from semlive.data.settings import EstimateSettings
from semlive.estimate import sutton


def uncorrected(experiment: Experiment) -> Found:
    """Nothing is corrected."""
    return Found(None, _nothing)


def joint(experiment: Experiment) -> Found:
    """The joint least squares with its automatic settings."""
    state = estimate.init(EstimateSettings(), experiment.grid, WIDTH_PX, HEIGHT_PX)
    spent = []
    for taken in experiment.pairs:
        begin = time.process_time()
        state = estimate.update(state, taken.pair, taken.phase, taken.times, taken.maps)
        spent.append(time.process_time() - begin)
    begin = time.process_time()
    solution = estimate.solve(state)
    spent_s = time.process_time() - begin
    found = estimate.to_estimate(solution, len(experiment.pairs))
    grown = None if found.raster is None else float(found.raster.magnification[-1] - found.raster.magnification[0])
    return Found(found.distortion, lambda dmap: estimate.correction(solution, dmap), grown, tuple(spent), spent_s)


def sutton2007(experiment: Experiment) -> Found:
    """The published procedure with its defaults."""
    begin = time.process_time()
    solution = _sutton(experiment, sutton.SuttonOptions())
    spent_s = time.process_time() - begin
    distortion = sutton.to_estimate(solution, len(experiment.pairs)).distortion
    return Found(distortion, lambda dmap: sutton.correction(solution, dmap), None, (), spent_s)


def no_drift(experiment: Experiment) -> Found:
    """The published procedure with drift left in: distortion alone is calibrated and corrected."""
    solution = _sutton(experiment, sutton.SuttonOptions(remove_drift=False))
    return Found(sutton.to_estimate(solution, 0).distortion, lambda dmap: sutton.correction(solution, dmap))


def parametric(experiment: Experiment) -> Found:
    """The published procedure with the classical forms for distortion."""
    solution = _sutton(experiment, sutton.SuttonOptions(passes=1))
    fit = fit_lens_distortion(solution)
    here = np.stack(experiment.grid.mesh(), axis=-1).reshape(-1, 2)

    def total(address: Field, frame: int) -> Field:
        drift = solution.drift_px(address, solution.state.frame_time(frame))
        return drift + fit.at(address - solution.options.carried * drift)

    def correct(dmap: DisparityMap) -> Correction:
        there = here + np.stack((dmap.u_px.ravel(), dmap.v_px.ravel()), axis=1)
        u, v = (item.reshape(dmap.grid.shape) for item in (total(there, dmap.current) - total(here, 0)).T)
        return Correction(dmap.current, u, v)

    ex, ey = (item.reshape(experiment.grid.shape) for item in fit.at(here).T)
    valid = np.ones(experiment.grid.shape, dtype=np.bool_)
    return Found(DistortionField(experiment.grid, ex, ey, np.zeros(experiment.grid.shape), valid), correct)


METHODS: dict[str, Callable[[Experiment], Found]] = {
    "uncorrected": uncorrected,
    "no_drift": no_drift,
    "parametric": parametric,
    "sutton2007": sutton2007,
    "joint": joint,
}


def _sutton(experiment: Experiment, options: sutton.SuttonOptions) -> sutton.SuttonSolution:
    state = sutton.init(EstimateSettings(), experiment.grid, WIDTH_PX, HEIGHT_PX)
    for taken in experiment.pairs:
        state = sutton.update(state, taken.pair, taken.phase, taken.times, taken.maps)
    return sutton.solve(state, options)


def _nothing(dmap: DisparityMap) -> Correction:
    zero = np.zeros(dmap.grid.shape)
    return Correction(dmap.current, zero, zero)
