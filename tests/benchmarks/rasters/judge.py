"""Compare a map with the truth of a scene.

A converged point is wrong if u or v is off by more than max(WRONG_PX, WRONG_SIGMAS stated sigma), or by more than GROSS_PX whatever the
stated sigma. Half a pixel is far above noise and interpolation, and is the tolerance of the reference of the real pairs. Normal errors
exceed 5 sigma in 1.1 of 10^6 points (u or v), so 10^5 points have 0.1 by chance and a bar of 0 can be met. The gross bound, the same as for
real pairs, keeps a large stated sigma from hiding a false match. Within a template of a lasting step a value between the displacements of
both sides is right, because a window there holds both.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semlive.data.disparity import DisparityMap

from .matchable import STEP_MARGIN_ROWS, matchable
from .scenes import Scene
from .textures import Field

WRONG_PX, WRONG_SIGMAS, GROSS_PX = 0.5, 5.0, 2.0


@dataclass(frozen=True, slots=True)
class Count:
    """What became of the points of some scenes.

    Attributes:
        points: all of them.
        matchable: that a careful person could match.
        matched: of these, called converged.
        converged: called converged, matchable or not.
        wrong: of the converged ones.
        worst_px: largest error of u or v of a converged point.
        squares: sum of squares of the errors of u and v of matched points in px^2.
        normalised: sum of squares of error / sigma of the same.
        within_1: number of these errors within 1 sigma.
        within_2: within 1.96 sigma.
        within_3: within 3 sigma.
    """

    points: int = 0
    matchable: int = 0
    matched: int = 0
    converged: int = 0
    wrong: int = 0
    worst_px: float = 0.0
    squares: float = 0.0
    normalised: float = 0.0
    within_1: int = 0
    within_2: int = 0
    within_3: int = 0

    def __add__(self, other: Count) -> Count:
        summed = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)}
        return Count(**{**summed, "worst_px": max(self.worst_px, other.worst_px)})

    @property
    def share(self) -> float:
        """Fraction of the matchable points that converged; 1 if there are none."""
        return self.matched / self.matchable if self.matchable else 1.0

    @property
    def rms_px(self) -> float:
        """Root mean square error of u and v of matched points."""
        return float(np.sqrt(self.squares / max(2 * self.matched, 1)))


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """(ny, nx) maps of the points of a scene: errors in px (zero where not converged), what is wrong, and what could be matched."""

    error_u: Field
    error_v: Field
    wrong: NDArray[np.bool_]
    matchable: NDArray[np.bool_]


def judge(s: Scene, m: DisparityMap) -> Verdict:
    """Compare a map with the truth."""
    x, y = (a.astype(int) for a in m.grid.mesh())
    size = (2 * STEP_MARGIN_ROWS + 1, 1)
    errors = []
    for value, true, smooth in ((m.u_px, s.u, s.smooth_u), (m.v_px, s.v, s.smooth_v)):
        step = true - smooth
        low, high = smooth + ndimage.minimum_filter(step, size), smooth + ndimage.maximum_filter(step, size)
        flat = (high - low)[y, x] < 0.05  # steps also change the position at which the smooth displacement is taken
        off = np.where(flat, value - true[y, x], value - np.clip(value, low[y, x], high[y, x]))
        errors.append(np.where(m.valid, off, 0.0))
    bound = [np.minimum(np.maximum(WRONG_PX, WRONG_SIGMAS * sigma), GROSS_PX) for sigma in (m.sigma_u_px, m.sigma_v_px)]
    wrong = m.valid & ((np.abs(errors[0]) > bound[0]) | (np.abs(errors[1]) > bound[1]))
    return Verdict(errors[0], errors[1], wrong, matchable(s, x, y))


def count(m: DisparityMap, v: Verdict) -> Count:
    """Count the points of one map."""
    matched = v.matchable & m.valid
    errors = np.concatenate([v.error_u[matched], v.error_v[matched]])
    ratio = np.abs(errors) / np.maximum(np.concatenate([m.sigma_u_px[matched], m.sigma_v_px[matched]]), 1e-9)
    largest = np.maximum(np.abs(v.error_u), np.abs(v.error_v))
    return Count(
        m.status.size, int(v.matchable.sum()), int(matched.sum()), int(m.valid.sum()), int(v.wrong.sum()), float(largest.max(initial=0.0)),
        float(np.sum(errors**2)), float(np.sum(ratio**2)), *(int(np.sum(ratio <= limit)) for limit in (1.0, 1.96, 3.0)),
    )  # fmt: skip
