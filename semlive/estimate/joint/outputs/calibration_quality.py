"""Quality of the calibration: extent of its translations, uncertainty of the distortion, and visited scan addresses."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import CalibrationQuality
from semlive.data.experiment import Phase
from semlive.data.notes import Note, NoteCode, warning
from semlive.estimate.joint.elimination.shared_parameters import shared_prior
from semlive.estimate.joint.elimination.smoother import distortion_covariance, solve_shared
from semlive.estimate.joint.observations.priors import Hyperparameters
from semlive.estimate.joint.observations.state import EstimatorState, rows_of
from semlive.estimate.joint.solution.posterior import Solution
from semlive.model import MotionKind

Field = NDArray[np.float64]
# An address counts as calibrated when the data reduced the standard deviation of its distortion below this fraction. Of the paper's
# grid no address counts after seven pairs along x (error 0.05 px rms), all after one more along y (0.013 px); +-4 px crosses fail.
COVERED = 0.1
MIN_COVERED = 0.5
MARGIN_SUBSETS = 1.0  # half a block to its outer points, and half a subset: so far did the outer points see
REPORT_FRACTION = 0.01
# A calibration is rejected if most of the grid is not covered and the uncertainty of a wave over the grid is larger: the residual of the
# published procedure. Seven pairs along x give 0.028 ... 0.042 px, crosses of 4 px 0.027 ... 0.037, of 8 px 0.021, of 12 px 0.015 or less.
POOR_PX = 0.02


@dataclass(frozen=True, slots=True)
class CalibratedRegion:
    """Rectangle of scan addresses at which calibration frames observed points.

    Attributes:
        x_px: first and last address along x, px.
        y_px: first and last address along y, px.
    """

    x_px: tuple[float, float]
    y_px: tuple[float, float]

    def holds(self, x_px: Field, y_px: Field) -> NDArray[np.bool_]:
        """Whether addresses lie inside the rectangle, elementwise."""
        inside_x = (x_px >= self.x_px[0]) & (x_px <= self.x_px[1])
        return inside_x & (y_px >= self.y_px[0]) & (y_px <= self.y_px[1])


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationAssessment:
    """Uncertainty of the distortion after the pairs so far, evaluated with a fixed, weak smoothness prior.

    The most likely prior is tight if the observed distortion is smooth. It would then give a small uncertainty in places without data (for
    example along y, after translations along x only).

    Attributes:
        covered: (ny, nx) True where the data, not the prior, determine the distortion.
        lever_px: (2,) extent of the translations along x and y, px.
        wave_sigma_px: (2,) standard uncertainty of a wave of one period over the grid, along x and along y, px.
    """

    covered: NDArray[np.bool_]
    lever_px: tuple[float, float]
    wave_sigma_px: tuple[float, float]

    @property
    def sufficient(self) -> bool:
        """Whether most of the grid is covered."""
        return float(self.covered.mean()) >= MIN_COVERED

    @property
    def poor(self) -> bool:
        """Whether the calibration is too weak to correct frames under load."""
        return not self.sufficient and max(self.wave_sigma_px) > POOR_PX

    def quality(self) -> CalibrationQuality:
        """The assessment in figures."""
        return CalibrationQuality(float(self.covered.mean()), self.lever_px, self.wave_sigma_px, self.message() if self.poor else "")

    def message(self) -> str:
        """Message that names the missing translations, with the figures."""
        weak, short = int(np.argmax(self.wave_sigma_px)), int(np.argmin(self.lever_px))
        both = max(self.lever_px) < 2 * min(self.lever_px) or weak != short
        advice = "in both directions" if both else f"along {'xy'[weak]}"
        return (
            f"distortion not determined yet: needs translations in both directions; the pairs so far moved {self.lever_px[0]:.3g} px along "
            f"x and {self.lever_px[1]:.3g} px along y, so waves of the distortion running along x are uncertain by "
            f"{self.wave_sigma_px[0]:.2g} px and along y by {self.wave_sigma_px[1]:.2g} px: add larger translations {advice}"
        )


def calibration(solution: Solution) -> CalibrationAssessment:
    """Assess the calibration from the pairs so far."""
    state, part = solution.state, solution.state.layout.part("distortion")
    loose = replace(solution.hyper, distortion=Hyperparameters().distortion)
    prior = shared_prior(state, loose, solution.shared_posterior.chain.border)
    before = np.asarray(np.linalg.inv(prior[part, part]), dtype=np.float64)
    # The belief about the distortion is about the border alone, so the elimination of the pairs serves both.
    after = distortion_covariance(solve_shared(solution.shared_posterior.chain, loose))
    along_x, along_y = slice(0, None, 2), slice(1, None, 2)
    ratio = [pointwise(state, after[at, at]) / pointwise(state, before[at, at]) for at in (along_x, along_y)]
    covered = np.sqrt(0.5 * (ratio[0] + ratio[1])) < COVERED
    waves = _waves(state)
    sigma = np.sqrt(np.maximum(*(np.einsum("ki,ij,kj->k", waves, after[at, at], waves) for at in (along_x, along_y))))
    return CalibrationAssessment(covered, translation_extent_px(solution), (float(sigma[0]), float(sigma[1])))


def translation_extent_px(solution: Solution) -> tuple[float, float]:
    """Extent along x and y of the image position in calibration and translation pairs (specimen motion plus drift), px."""
    state = solution.state
    drift = state.drift
    assert drift is not None  # a solution has data
    kinds, every = state.motions.kinds, dict(zip((0, *state.motions.pairs), state.phases, strict=True))
    motion = np.append(solution.part("motion"), (0.0, 0.0))  # pair 0 does not move
    starts = np.cumsum([0, *(kind.value for kind in kinds)])[:-1]
    along_y = np.array([1 if kind is MotionKind.RIGID else 3 for kind in kinds], dtype=np.int64)
    shifts = np.stack((motion[np.append(starts, len(motion) - 2)], motion[np.append(starts + along_y, len(motion) - 1)]), axis=1)
    row = {pair: number for number, pair in enumerate((*state.motions.pairs, 0))}
    frames = [frame for frame in state.frames if frame.frame < 2 or every[frame.frame // 2] is not Phase.TENSION]
    index, value = drift.spline.local(np.array([frame.start_s for frame in frames]))
    drifted = np.einsum("nk,nkc->nc", value, solution.part("drift").reshape(-1, 2)[index])
    extent = np.ptp(shifts[[row[frame.frame // 2] for frame in frames]] + drifted, axis=0)
    return float(extent[0]), float(extent[1])


def support(state: EstimatorState) -> CalibratedRegion | None:
    """Region observed by the frames of calibration and translation pairs; None before load steps or without calibration."""
    if Phase.TENSION not in state.phases:
        return None
    extent, margin = state.calibrated, MARGIN_SUBSETS * state.grid.subset_px
    if extent is None:
        return None
    # The first and last points of a frame lie half a block beyond the middles of its outer blocks.
    low, high = extent.lowest_px - margin, extent.highest_px + margin
    return CalibratedRegion((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))


def outside_region_notes(state: EstimatorState, pairs: Collection[int]) -> list[Note]:
    """Warning about frames of some pairs with points outside the calibrated addresses; empty without such frames."""
    area = support(state)
    if area is None:
        return []
    worst, worst_frame, frames = 0.0, -1, 0
    for rows in rows_of(state, pairs):
        if not rows.from_reference or not rows.dmap.valid.any():
            continue
        there = rows.position_px + state.centre_px + rows.disparity_px
        used = rows.weight.any(axis=1)
        fraction = 1.0 - float(area.holds(there[used, 0], there[used, 1]).mean()) if used.any() else 0.0
        frames += fraction > REPORT_FRACTION
        if fraction > worst:
            worst, worst_frame = fraction, rows.current
    if frames == 0:
        return []
    text = (
        f"the specimen left the area that the calibration covered (x {area.x_px[0]:.0f} ... {area.x_px[1]:.0f}, "
        f"y {area.y_px[0]:.0f} ... {area.y_px[1]:.0f} px): {frames} frames have points beyond it, frame {worst_frame} "
        f"{100 * worst:.0f} %; these have no displacement; calibrate with larger translations or bring the specimen back"
    )
    return [warning(NoteCode.OUTSIDE_CALIBRATED_AREA, text)]


def pointwise(state: EstimatorState, covariance: Field) -> Field:
    """(ny, nx) variance of one component on the grid, from the covariance of its coefficients."""
    (at_x, x), (at_y, y) = state.distortion.along_x.local(state.grid.x_px), state.distortion.along_y.local(state.grid.y_px)
    count_x, count_y = state.distortion.along_x.size, state.distortion.along_y.size
    four = covariance.reshape(count_y, count_x, count_y, count_x)
    # Four splines act at a point, of some fifteen: summed over these alone it takes 3.9 ms instead of 7.3 at 18,000 points.
    couples = tuple(itertools.product(range(at_x.shape[1]), repeat=2))
    along_y, found = np.zeros((len(y), count_x, count_x)), np.zeros((len(y), len(x)))
    for i, j in couples:
        along_y += (y[:, i] * y[:, j])[:, None, None] * four[at_y[:, i], :, at_y[:, j], :]
    for i, j in couples:
        found += (x[:, i] * x[:, j]) * along_y[:, at_x[:, i], at_x[:, j]]
    return np.clip(found, 0.0, None)


def _splines_on_grid(state: EstimatorState) -> tuple[Field, Field]:
    index_x, value_x = state.distortion.along_x.local(state.grid.x_px)
    index_y, value_y = state.distortion.along_y.local(state.grid.y_px)
    rows_x, rows_y = np.zeros((state.grid.nx, state.distortion.along_x.size)), np.zeros((state.grid.ny, state.distortion.along_y.size))
    np.put_along_axis(rows_x, index_x, value_x, axis=1)
    np.put_along_axis(rows_y, index_y, value_y, axis=1)
    return rows_y, rows_x


def _waves(state: EstimatorState) -> Field:
    """(2, m) amplitude of a cosine of one period over the grid, along x and y, as a function of the coefficients of one component."""
    rows_y, rows_x = _splines_on_grid(state)
    flat_x, flat_y = rows_x.mean(axis=0), rows_y.mean(axis=0)
    wave_x, wave_y = (
        2.0 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count) @ rows / count
        for count, rows in ((state.grid.nx, rows_x), (state.grid.ny, rows_y))
    )
    return np.stack((np.kron(flat_y, wave_x), np.kron(wave_y, flat_x)))
