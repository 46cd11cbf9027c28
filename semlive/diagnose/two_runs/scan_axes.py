"""Scan axes from stage moves before and after a rotation of the scan.

Commands c move the image by A1 c = M S c, and by A2 c = M R S c after the rotation R of the scan. S is the matrix of the stage, M that of
the scan axes. T = A2 A1^-1 = M R M^-1 is independent of the stage and of the pixel size. Its trace determines the rotation, its other
elements M.
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
MIN_ROTATION_RAD = math.radians(5.0)  # distance from 0 and 180 degrees, where the axes are not observable
MIN_MOMENT_PX2 = 25.0  # smallest second moment of the commands in any direction
MIN_SCALE = 0.01  # smallest determinant of the stage response
SAME_PATH_TOLERANCE_PX = 0.1
_UNKNOWNS = 5  # offset, two of the drift, two of the stage
_MIN_SIGMAS = 3.0
_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class StageResponse:
    """Response of the image to stage commands in one run.

    Attributes:
        matrix: (2, 2) image motion per commanded motion.
        commanded_px: (n, 2) commands, with offset and drift removed, px.
        residual_px: (n, 2) residual of the moves, px.
    """

    matrix: Array
    commanded_px: Array
    residual_px: Array

    @property
    def spread(self) -> Array:
        """(2, 2) inverse of the second moments of the commands."""
        return np.asarray(np.linalg.inv(self.commanded_px.T @ self.commanded_px), dtype=np.float64)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual of both axes."""
        return 2 * (len(self.residual_px) - _UNKNOWNS)


@dataclass(frozen=True, slots=True, eq=False)
class ScanAxes:
    """Scan axes from two runs.

    Attributes:
        matrix: (2, 2) T, from image motion in the first run to that in the second for the same command.
        covariance: (4, 4) covariance of T, row by row.
        turn: rotation of the scan.
        x_excess: relative excess of the column distance over the row distance.
        skew: deviation of the angle between the axes from 90 degrees.
        freedom: degrees of freedom of the uncertainties.
    """

    matrix: Array
    covariance: Array
    turn: ParameterEstimate
    x_excess: ParameterEstimate
    skew: ParameterEstimate
    freedom: int

    def log_bayes_factors(self) -> dict[str, tuple[ParameterEstimate, float, float]]:
        """For each effect: its parameter, the p-value of an F-test jointly with the other effect, and its log Bayes factor."""
        effects = {"anisotropic_pixel": self.x_excess, "scan_nonorthogonality": self.skew}
        return {name: (effect, *_test(effect, self.freedom)) for name, effect in effects.items()}


def _test(parameter: ParameterEstimate, freedom: int) -> tuple[float, float]:
    result = f_test([RegressionTerm(parameter.value, parameter.sigma, (parameter.value / parameter.sigma) ** 2, float(freedom), freedom)])
    assert result is not None  # there is a scatter
    return result


def scan_axes(runs: Sequence[HyperparameterGrid], slopes: Sequence[Array]) -> ScanAxes | None:
    """Scan axes from two runs; None if the scan was not rotated or the moves do not determine them.

    Args:
        runs: baselines of the runs.
        slopes: (2, 2) gradient, for each run, of the affine part of its distortion on the common disc; the gauge of its points differs.
    """
    first, second = (stage_response(run, slope) for run, slope in zip(runs, slopes, strict=True))
    return None if first is None or second is None else axes_between(first, second)


def axes_between(first: StageResponse, second: StageResponse) -> ScanAxes | None:
    """Scan axes from the stage responses before and after a rotation of the scan; None without a rotation."""
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
    """(2, 2) T, its (4, 4) covariance and the degrees of freedom of that covariance.

    If both runs followed the same path, repeatable errors of the stage cancel: with a backlash of 0.8 px the uncertainty is 0.0005 instead
    of 0.0010.
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
    """Stage response from the pairs without load, with drift as a parabola in time; None for too few pairs or moves along one line.

    Args:
        run: baseline of the run.
        slope: (2, 2) gradient of the affine part of the distortion, which is attributed to the scan axes.
    """
    scene, motions = run.design.observation.geometry, run.design.observation.state.motions
    unloaded = ~scene.steps.loaded[::2]
    pairs, commanded = scene.pair[::2][unloaded], np.cumsum(scene.steps.move_px[::2], axis=0)[unloaded]
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
    """A scalar function of a matrix, and its standard uncertainty."""
    steps = _STEP * np.eye(4).reshape(4, 2, 2)
    slope = np.array([function(between + step) - function(between - step) for step in steps]) / (2.0 * _STEP)
    return function(between), float(np.sqrt(slope @ covariance @ slope))


def _twist(between: Array) -> float:
    """Imaginary part of the eigenvalues of T; NaN if they are real, which excludes a rotated scan."""
    half, size = 0.5 * float(np.trace(between)), float(np.linalg.det(between))
    return math.sqrt(size - half**2) if size > half**2 else math.nan


def _turn(between: Array) -> float:
    """Rotation of the scan, positive from x towards y, opposite to that of the image."""
    return -math.copysign(1.0, between[1, 0]) * math.atan2(_twist(between), 0.5 * float(np.trace(between)))


def _x_excess(between: Array) -> float:
    """Excess e of the x axis: with M = [[1 - e, -s], [0, 1]]^-1, T has the eigenvectors ((s +- i) / (1 - e), 1)."""
    return 1.0 - abs(float(between[1, 0])) / _twist(between)


def _skew(between: Array) -> float:
    return math.copysign(0.5, between[1, 0]) * float(between[0, 0] - between[1, 1]) / _twist(between)
