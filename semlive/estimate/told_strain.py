"""Mean strain of a correction: how uncertain it is, and how far it moved since it was applied."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.strain import Tensor2
from semlive.estimate.border import Codes, codes_of, joint_of
from semlive.estimate.posterior import Solution
from semlive.model import Axis, Sighting, sighting, with_drift

ENOUGH = 40


@dataclass(frozen=True, slots=True, eq=False)
class CorrectionStrain:
    """The mean strain that a correction took off a map, as it was at one time.

    Attributes:
        codes: (m,) parameters that it hangs on.
        rows: (3, m) exx, eyy, exy as linear functions of them.
        value: (3,) at the estimate of that time.
        sigma: standard uncertainty then.
    """

    codes: Codes
    rows: NDArray[np.float64]
    value: NDArray[np.float64]
    sigma: Tensor2


def correction_strain(solution: Solution, dmap: DisparityMap) -> CorrectionStrain:
    """What the correction of a map from frame 0 gives to the mean strain over its valid points, and how uncertain that is.

    This is the systematic part: the same for every point of the frame, whatever its own DIC noise. Corrections are smooth, so
    some ENOUGH points each way stand for all: within 1 % of what 18,000 points give (6 % in frame 1), at a ninth of their time.
    """
    dmap = _thinned(dmap)
    reference, current = sightings(solution, dmap)
    layout, valid = solution.state.layout, dmap.valid.ravel()
    if valid.sum() < 3:
        return CorrectionStrain(np.zeros(0, dtype=np.int64), np.zeros((3, 0)), np.zeros(3), Tensor2(np.inf, np.inf, np.inf))
    position = np.column_stack((np.ones(int(valid.sum())), reference.x_px[valid], reference.y_px[valid]))
    slopes = np.zeros((2, len(valid)))
    slopes[:, valid] = np.linalg.pinv(position)[1:]
    along = np.zeros((2, 2, layout.size))  # slope in x or y, of u or v
    for sign, seen in ((1.0, current), (-1.0, reference)):
        for effect in (one for one in solution.state.model if not one.needs_ideal):
            part = layout.part(effect.name)
            for columns in effect.columns(seen):
                for direction in (0, 1):
                    for component in (0, 1) if columns.axis is Axis.EACH else (int(columns.axis is Axis.Y),):
                        at = 2 * columns.index + component if columns.axis is Axis.EACH else columns.index
                        weights = sign * slopes[direction][:, None] * columns.value
                        along[direction, component, part] += np.bincount(at.ravel(), weights.ravel(), part.stop - part.start)
    rows = np.stack((along[0, 0], along[1, 1], 0.5 * (along[1, 0] + along[0, 1])))
    sigma = np.sqrt(np.clip(np.diag(solution.covariance_of(rows)), 0.0, None))
    touched = np.flatnonzero(rows.any(axis=0))
    own = np.ascontiguousarray(rows[:, touched])
    return CorrectionStrain(codes_of(layout, touched), own, own @ solution.mean[touched], Tensor2(*(float(one) for one in sigma)))


def correction_strain_sigma(solution: Solution, dmap: DisparityMap) -> Tensor2:
    """Standard uncertainty that the correction of a map from frame 0 gives to the mean strain over its valid points."""
    return correction_strain(solution, dmap).sigma


def strain_moved(solution: Solution, told: CorrectionStrain) -> Tensor2:
    """How far the mean strain of a corrected map would move if it were corrected with another solution, exx, eyy and exy."""
    moved = told.value - told.rows @ solution.mean[joint_of(solution.state.layout, told.codes)]
    return Tensor2(*(float(one) for one in moved))


def sightings(solution: Solution, dmap: DisparityMap) -> tuple[Sighting, Sighting]:
    """Where and when frame 0 and the map's frame saw its points."""
    state = solution.state
    if dmap.reference != 0:
        raise ValueError(f"corrections are for maps from frame 0, not from frame {dmap.reference}")
    x, y = dmap.grid.mesh()
    reference = sighting(state.frame_time(0), x, y)
    current = sighting(state.frame_time(dmap.current), x + dmap.u_px, y + dmap.v_px)
    return with_drift(state.model, solution.mean, reference), with_drift(state.model, solution.mean, current)


def _thinned(dmap: DisparityMap) -> DisparityMap:
    """Every k-th point of every k-th row, with ENOUGH of them along the shorter side."""
    k = max(1, min(dmap.grid.shape) // ENOUGH)
    rows, columns = (slice((n - 1) % k // 2, None, k) for n in dmap.grid.shape)
    grid = replace(
        dmap.grid,
        x0_px=dmap.grid.x0_px + columns.start * dmap.grid.step_px,
        y0_px=dmap.grid.y0_px + rows.start * dmap.grid.step_px,
        step_px=k * dmap.grid.step_px,
        nx=len(range(*columns.indices(dmap.grid.nx))),
        ny=len(range(*rows.indices(dmap.grid.ny))),
    )
    maps = {name: getattr(dmap, name)[rows, columns] for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "status")}
    return replace(dmap, grid=grid, covariance_px2=None, iterations=None, **maps)
