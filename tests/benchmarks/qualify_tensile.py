"""Predicted strain noise of simulated microscopes, compared with the error of the strain in a tensile run that follows.

The qualification has the pairs of the calibration only. The strain of the frames under load is corrected by the estimate of all pairs, as
in a run, and compared with the true strain. Frames under load have noise of their own, except frame 0, the reference of all maps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numexp.coverage import CALIBRATION_PAIRS, GRID, SMALL, WINDOW_POINTS
from numexp.experiment import ObservedFrame, Taken, make_experiment
from numexp.world import HEIGHT_PX, WIDTH_PX, Field

from semlive import estimate, mechanics
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.estimate import Solution
from semlive.qualify.figures.noise import strain_scatter

GAUGES = Grid(101, 101, 10, 80, 64, 43)
"""Grid of the strain: gauges of 83 px, of which 65 lie side by side. The estimate has the points of the coverage, which are fewer."""
NOISE_PX = (0.012, 0.04)
"""Smallest and largest noise of a displacement; drawn uniformly in its logarithm."""
FIRST_SEED = 60_000


@dataclass(frozen=True, slots=True)
class Compared:
    """One microscope.

    Attributes:
        noise_px: true noise of a displacement.
        predicted: strain noise by the qualification, the largest of exx, eyy and exy.
        low: lower end of its 95 % interval.
        high: upper end of its 95 % interval.
        found: root mean square error of the same component over gauges and frames under load.
        constant: root mean square of the mean error of a frame, which is part of `found`.
    """

    noise_px: float
    predicted: float
    low: float
    high: float
    found: float
    constant: float

    @property
    def ratio(self) -> float:
        """Predicted noise over the error that was found."""
        return self.predicted / self.found


def compared(number: int) -> Compared:
    """Qualify one microscope, and strain a specimen in it."""
    seed = FIRST_SEED + number
    low, high = np.log(NOISE_PX)
    noise_px = float(np.exp(np.random.default_rng((seed, 37)).uniform(low, high)))
    case = replace(SMALL["correlated"], noise_px=noise_px)
    state = estimate.init(EstimateSettings(window_points=WINDOW_POINTS), GRID, WIDTH_PX, HEIGHT_PX)
    for taken in make_experiment(case, seed, GRID, CALIBRATION_PAIRS).pairs:
        state = estimate.update(state, taken.pair, taken.phase, taken.times, taken.maps)
    solution = estimate.solve(state)
    pairs = make_experiment(case, seed, GAUGES, CALIBRATION_PAIRS).pairs  # the same drift, distortion and noise
    scatter = strain_scatter([taken.maps[0] for taken in pairs[:CALIBRATION_PAIRS]], WINDOW_POINTS)
    assert scatter is not None  # the grid is large enough
    component = int(np.argmax((scatter.observed + scatter.followed).mean(axis=0)))
    errors = [error[:, component] for error in _errors(pairs, solution)]
    means = np.array([error.mean() for error in errors])
    return Compared(noise_px, *scatter.worst(), float(np.sqrt(np.mean(np.concatenate(errors) ** 2))), float(np.sqrt(np.mean(means**2))))


def _errors(pairs: tuple[Taken, ...], solution: Solution) -> Iterator[Field]:
    """(n, 3) error of exx, eyy and exy of the valid gauges that the edge does not cut, for each frame under load."""
    half = WINDOW_POINTS // 2
    for taken in pairs:
        for frame in taken.observed if taken.phase is Phase.TENSION else ():
            dmap = next(found for found in taken.maps if (found.reference, found.current) == (0, frame.exact.current))
            field = mechanics.strain(mechanics.displacement(dmap, estimate.correction(solution, dmap)), WINDOW_POINTS)
            inner = np.s_[half:-half, half:-half]
            yield (np.stack((field.exx, field.eyy, field.exy), axis=-1) - _true(frame))[inner][field.valid[inner]]


def _true(frame: ObservedFrame) -> Field:
    gradient = frame.gradient
    return np.array([gradient[0, 0], gradient[1, 1], 0.5 * (gradient[0, 1] + gradient[1, 0])])
