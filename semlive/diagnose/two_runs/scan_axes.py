"""The scan's axes, by how one stage moves the picture before and after the scan is turned.

Commands c move the picture by A1 c = M S c, and by A2 c = M R S c once the scan is turned: S is the stage's, M has the scan's axes. So
T = A2 A1^-1 = M R M^-1 holds neither the stage nor the size of a pixel. Its trace tells the turn, and the rest M.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import ParameterEstimate
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.scalars.regression import RegressionTerm, f_test
from semlive.diagnose.two_runs.disc_basis import baseline_mean, parameter_subset

Array = NDArray[np.float64]
MIN_PAIRS = 7  # two more than unknowns along each axis
MIN_ROTATION_RAD = math.radians(5.0)  # from 0 and 180 degrees, where all axes look alike
MIN_MOMENT_PX2 = 25.0  # moments of commands across
MIN_SCALE = 0.01  # of a picture that a stage moves at all
SAME_PATH_TOLERANCE_PX = 0.1
_UNKNOWNS = 5  # offset, two of the drift, two of the stage
_MIN_SIGMAS = 3.0
_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class StageResponse:
    """How a stage carried the picture in one run.

    Attributes:
        matrix: (2, 2) px of the picture to a px of the command.
        commanded_px: (n, 2) about offset and drift.
        residual_px: (n, 2) what moves are off.
    """

    matrix: Array
    commanded_px: Array
    residual_px: Array

    @property
    def spread(self) -> Array:
        """(2, 2) inverse of the commands' moments."""
        return np.asarray(np.linalg.inv(self.commanded_px.T @ self.commanded_px), dtype=np.float64)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of what moves are off, both axes together."""
        return 2 * (len(self.residual_px) - _UNKNOWNS)


@dataclass(frozen=True, slots=True, eq=False)
class ScanAxes:
    """What two runs say of the scan's axes.

    Attributes:
        matrix: (2, 2) T, from a move of the picture in the first run to the same stage's in the second.
        covariance: (4, 4) of it, row by row.
        turn: the angle of the scan.
        x_excess: what columns are too far apart by, against rows.
        skew: what the angle between the axes lacks.
        freedom: degrees of freedom of the scatter that uncertainties are told by.
    """

    matrix: Array
    covariance: Array
    turn: ParameterEstimate
    x_excess: ParameterEstimate
    skew: ParameterEstimate
    freedom: int

    def log_bayes_factors(self) -> dict[str, tuple[ParameterEstimate, float, float]]:
        """By name: its parameter, the p-value of an F-test of it beside the other, and the logarithm of its Bayes factor."""
        effects = {"anisotropic_pixel": self.x_excess, "scan_nonorthogonality": self.skew}
        return {name: (effect, *_test(effect, self.freedom)) for name, effect in effects.items()}


def _test(parameter: ParameterEstimate, freedom: int) -> tuple[float, float]:
    result = f_test([RegressionTerm(parameter.value, parameter.sigma, (parameter.value / parameter.sigma) ** 2, float(freedom), freedom)])
    assert result is not None  # there is a scatter
    return result


def scan_axes(runs: Sequence[HyperparameterGrid], slopes: Sequence[Array]) -> ScanAxes | None:
    """The scan's axes by two runs; None where the scan was not turned, or the moves cannot tell.

    Args:
        runs: their baselines.
        slopes: (2, 2) of each, the affine part that its distortion has where both are compared: the gauge of its own points is another.
    """
    first, second = (stage_response(run, slope) for run, slope in zip(runs, slopes, strict=True))
    return None if first is None or second is None else axes_between(first, second)


def axes_between(first: StageResponse, second: StageResponse) -> ScanAxes | None:
    """The scan's axes by how one stage carried the picture before and after the scan was turned; None where it was not."""
    between, covariance, freedom = stage_response_change(first, second)
    turn, x_excess, skew = (_with_sigma(value, between, covariance) for value in (_turn, _x_excess, _skew))
    distance_rad = min(abs(turn[0]), math.pi - abs(turn[0]))
    if not distance_rad > MIN_ROTATION_RAD + _MIN_SIGMAS * turn[1]:
        return None
    return ScanAxes(
        between, covariance, ParameterEstimate("turn_rad", *turn, "rad"), ParameterEstimate("x_excess", *x_excess, "1"),
        ParameterEstimate("skew_rad", *skew, "rad"), freedom,
    )  # fmt: skip


def stage_response_change(first: StageResponse, second: StageResponse) -> tuple[Array, Array, int]:
    """(2, 2) T, (4, 4) covariance of it and the degrees of freedom that it is told by.

    Where both runs went the same way, what a stage does alike each time is no error: backlash of 0.8 px had made uncertainties of
    0.0005 those of 0.0010.
    """
    back = np.linalg.inv(first.matrix)
    between = second.matrix @ back
    wide: Array = np.kron(np.eye(2), back.T @ second.spread @ back).astype(np.float64)
    if first.commanded_px.shape == second.commanded_px.shape and np.allclose(
        first.commanded_px, second.commanded_px, atol=SAME_PATH_TOLERANCE_PX
    ):
        difference_px = second.residual_px - first.residual_px @ between.T
        return between, float(np.sum(difference_px**2)) / first.freedom * wide, first.freedom
    freedom = first.freedom + second.freedom
    wide = wide + np.kron(between @ between.T, back.T @ first.spread @ back).astype(np.float64)
    return between, float(np.sum(first.residual_px**2) + np.sum(second.residual_px**2)) / freedom * wide, freedom


def stage_response(run: HyperparameterGrid, slope: Array) -> StageResponse | None:
    """By the pairs that were not loaded; drift between pairs counts as a parabola in time. None where they are too few or lead one way.

    Args:
        run: its baseline.
        slope: (2, 2) affine part of the distortion that is to count as the scan's own axes.
    """
    scene, motions = run.design.observation.geometry, run.design.observation.state.motions
    unloaded = ~scene.loaded[::2]
    pairs, commanded = scene.pair[::2][unloaded], np.cumsum(scene.move_px[::2], axis=0)[unloaded]
    if len(pairs) < MIN_PAIRS:
        return None
    own = baseline_mean(run)[parameter_subset(run, "motion")]
    fitted = np.array([motions.shift_and_gradient(int(pair), own)[0] for pair in pairs]) @ (np.eye(2) + slope).T
    late = np.linspace(-1.0, 1.0, len(pairs))
    base = np.linalg.qr(np.stack([np.ones_like(late), late, late**2], axis=-1))[0]
    moves, observed = (value - base @ (base.T @ value) for value in (commanded, fitted))
    moments = moves.T @ moves
    if not np.linalg.eigvalsh(moments)[0] > MIN_MOMENT_PX2:
        return None
    by = np.asarray(np.linalg.solve(moments, moves.T @ observed).T, dtype=np.float64)
    return StageResponse(by, moves, observed - moves @ by.T) if abs(np.linalg.det(by)) > MIN_SCALE else None


def _with_sigma(function: Callable[[Array], float], between: Array, covariance: Array) -> tuple[float, float]:
    """A number that a matrix tells, and its standard uncertainty."""
    steps = _STEP * np.eye(4).reshape(4, 2, 2)
    slope = np.array([function(between + step) - function(between - step) for step in steps]) / (2.0 * _STEP)
    return function(between), float(np.sqrt(slope @ covariance @ slope))


def _twist(between: Array) -> float:
    """Imaginary part of the eigenvalues of T; NaN where they are real, as no turned scan's are."""
    half, size = 0.5 * float(np.trace(between)), float(np.linalg.det(between))
    return math.sqrt(size - half**2) if size > half**2 else math.nan


def _turn(between: Array) -> float:
    """Of the scan, x towards y positive: the picture turns the other way."""
    return -math.copysign(1.0, between[1, 0]) * math.atan2(_twist(between), 0.5 * float(np.trace(between)))


def _x_excess(between: Array) -> float:
    """With M = [[1 - e, -s], [0, 1]]^-1 T has the eigenvectors ((s +- i) / (1 - e), 1)."""
    return 1.0 - abs(float(between[1, 0])) / _twist(between)


def _skew(between: Array) -> float:
    return math.copysign(0.5, between[1, 0]) * float(between[0, 0] - between[1, 1]) / _twist(between)
