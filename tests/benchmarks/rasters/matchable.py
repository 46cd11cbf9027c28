"""Which points of a scene a careful person could match: from truth and signal to noise alone, without any correlation.

A point is matchable if a template of TEMPLATE_PX around it

- lies within both frames, away from lasting steps (of those two motions meet within it), and at most a tenth of it is clipped;
- shows the same in both frames: correlation of the noise-free contents, offset and plane removed, of at least MIN_CORRELATION;
- carries enough information: the Cramer-Rao bound of its displacement is at most MAX_SIGMA_PX in the worst direction. Each row has an
  unknown offset, and as far as the scene has them an unknown gain, tilt and shift. Variances of both frames count;
- is not displaced by what differs between the frames (tails, shadows): the linearised shift of a least-squares fit to the noise-free
  contents is at most MAX_SYSTEMATIC_PX.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from .motion import slow_part
from .scenes import Scene
from .textures import HEIGHT_PX, WIDTH_PX, Field

TEMPLATE_PX = 49  # near the 48 px of the blocks from which the reference of real pairs was made
MAX_SIGMA_PX = 0.1
MIN_CORRELATION = 0.8
MAX_SYSTEMATIC_PX = 0.25
MAX_CLIPPED = 0.1
STEP_MARGIN_ROWS = TEMPLATE_PX // 2 + 2


def _sums(values: Field) -> Field:
    """Sums over the template of each pixel, by their mean (values outside count as zero)."""
    return ndimage.uniform_filter(values, TEMPLATE_PX, mode="constant") * TEMPLATE_PX**2


def _row_sums(values: Field) -> Field:
    """Sums over one row of the template of each pixel."""
    return ndimage.uniform_filter1d(values, TEMPLATE_PX, axis=1, mode="constant") * TEMPLATE_PX


def at_second(s: Scene, values: Field, fill: float) -> Field:
    """Values of the second frame at the true positions of the pixels of the first."""
    y, x = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    return np.asarray(ndimage.map_coordinates(values, [y + s.v, x + s.u], order=3, mode="constant", cval=fill))


def _inverse_variance(s: Scene) -> Field:
    """(height, width) of the difference of both frames at one material point; zero where a row is lost or jumps, or a pixel is clipped."""
    first, second = s.optics
    y = np.clip(np.rint(np.mgrid[:HEIGHT_PX, :WIDTH_PX][0] + s.v), 0, HEIGHT_PX - 1).astype(int)
    variance = first.noise.variance(s.clean_first) + second.noise.variance(at_second(s, s.clean_second, 0.0))
    spoiled = [optics.brightness.lost | optics.rows.jumped for optics in s.optics]
    usable = ~spoiled[0][:, None] & ~spoiled[1][y] & ~clipped(s)
    return np.where(usable, 1.0 / variance, 0.0)


def clipped(s: Scene) -> NDArray[np.bool_]:
    """(height, width) whether a pixel of the first frame is clipped in either frame."""
    second = at_second(s, s.clean_second, 128.0)
    return (s.clean_first <= 0.5) | (s.clean_first >= 254.5) | (second <= 0.5) | (second >= 254.5)


def _row_information(s: Scene) -> Field:
    """(height, width, 2, 2) information about (u, v) in one row of the template of each pixel; zero where a row is lost or jumps."""
    weight, f = _inverse_variance(s), s.clean_first
    gx, gy = np.gradient(f, axis=1), np.gradient(f, axis=0)
    # Unknowns of a row after u and v with the precision that is known of them: offset, then gain and tilt if the scene has them.
    unknown: list[tuple[Field, float]] = [(np.ones_like(f), 0.0)]
    first, second = (optics.brightness for optics in s.optics)
    gain_sd = np.hypot(np.std(first.gain), np.std(second.gain))
    if gain_sd:
        unknown.append((f - f.mean(), 1.0 / gain_sd**2))
    if np.any(first.tilt_grey):
        unknown.append((np.broadcast_to(np.linspace(-1.0, 1.0, WIDTH_PX), f.shape), 0.0))
    basis = [gx, gy, *(values for values, _ in unknown)]
    normal = np.empty((*f.shape, len(basis), len(basis)))
    for i, a in enumerate(basis):
        for k, b in enumerate(basis[i:], start=i):
            normal[..., i, k] = normal[..., k, i] = _row_sums(weight * a * b)
    ridge = 1e-9 * np.einsum("...ii->...i", normal)[..., 2:] + 1e-12  # a lost row has no equations
    nuisance = normal[..., 2:, 2:] + ridge[..., None] * np.eye(len(unknown)) + np.diag([precision for _, precision in unknown])
    cross = normal[..., :2, 2:]
    return normal[..., :2, :2] - cross @ np.linalg.solve(nuisance, np.swapaxes(cross, -1, -2))


def sigma_bound_px(s: Scene, x_px: NDArray[np.int64], y_px: NDArray[np.int64]) -> Field:
    """Square root of the largest eigenvalue of the Cramer-Rao bound of (u, v) of the template at each point (n,).

    Shifts of single rows are normal with the covariance from which they were drawn; the template must lie within the frame.
    """
    rows = y_px[:, None] + np.arange(-(TEMPLATE_PX // 2), TEMPLATE_PX // 2 + 1)
    information = _row_information(s)[rows, x_px[:, None]]  # (n, rows, 2, 2)
    variance = s.optics[0].rows.sd_px ** 2 + s.optics[1].rows.sd_px ** 2
    if variance.any():
        fast = (np.eye(TEMPLATE_PX + 40) - slow_part(TEMPLATE_PX + 40))[20:-20]
        shape = fast @ fast.T
        shifts = np.kron(shape / shape[0, 0], np.diag(variance))  # row by row: u, v
        n, size = len(x_px), 2 * TEMPLATE_PX
        per_row = np.zeros((n, TEMPLATE_PX, 2, TEMPLATE_PX, 2))
        each = np.arange(TEMPLATE_PX)
        per_row[:, each, :, each] = np.swapaxes(information, 0, 1)
        blocks = per_row.reshape(n, size, size)
        mean = np.tile(np.eye(2), (TEMPLATE_PX, 1))
        summed = mean.T @ blocks @ np.linalg.solve(np.eye(size) + shifts @ blocks, np.broadcast_to(mean, (n, size, 2)))
    else:
        summed = information.sum(axis=1)
    smallest = np.linalg.eigvalsh(0.5 * (summed + np.swapaxes(summed, -1, -2)))[:, 0]
    return 1.0 / np.sqrt(np.clip(smallest, 1e-12, None))


def agreement(s: Scene) -> tuple[Field, Field]:
    """(height, width) correlation of the noise-free contents of both templates, and the apparent shift of their difference in px."""
    f, g = s.clean_first, at_second(s, s.clean_second, 128.0)
    y, x = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    count, half = TEMPLATE_PX**2, TEMPLATE_PX // 2
    spread = count * half * (half + 1) / 3.0  # sum of squares of x over a template

    def inner(a: Field, b: Field) -> Field:
        """Scalar product over a template of a and b after removal of offset and plane."""
        out = _sums(a * b) - _sums(a) * _sums(b) / count
        for position in (x, y):
            out -= (_sums(a * position) - position * _sums(a)) * (_sums(b * position) - position * _sums(b)) / spread
        return out

    ff, gg, fg = inner(f, f), inner(g, g), inner(f, g)
    correlation = fg / np.sqrt(np.clip(ff * gg, 1e-12, None))
    gain = fg / np.clip(gg, 1e-12, None)
    gx, gy = np.gradient(f, axis=1), np.gradient(f, axis=0)
    xx, xy, yy = inner(gx, gx), inner(gx, gy), inner(gy, gy)
    right = [inner(gradient, f) - gain * inner(gradient, g) for gradient in (gx, gy)]
    determinant = np.clip(xx * yy - xy**2, 1e-12, None)
    feigned = np.hypot((yy * right[0] - xy * right[1]) / determinant, (xx * right[1] - xy * right[0]) / determinant)
    return correlation, feigned


def near_step(s: Scene) -> NDArray[np.bool_]:
    """(height, width) whether a lasting step of either frame lies within the rows of a template and a margin."""
    near = np.zeros((HEIGHT_PX, WIDTH_PX), bool)
    y = np.mgrid[:HEIGHT_PX, :WIDTH_PX][0]
    for optics, position in zip(s.optics, (y, y + s.v), strict=True):
        for row in optics.rows.step_rows:
            near |= np.abs(position - row) <= STEP_MARGIN_ROWS + abs(np.diff(optics.rows.steps[1])[row - 1])
    return near


def inside(s: Scene) -> NDArray[np.bool_]:
    """(height, width) whether the template and one pixel around lie within both frames."""
    half = TEMPLATE_PX // 2 + 1
    y, x = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    out = np.ones(x.shape, bool)
    for px, py in ((x, y), (x + s.u, y + s.v)):
        out &= (px >= half) & (px < WIDTH_PX - half) & (py >= half) & (py < HEIGHT_PX - half)
    return out


def matchable(s: Scene, x_px: NDArray[np.int64], y_px: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether points of the first frame are matchable, of the shape of `x_px` and `y_px` (pixel positions)."""
    correlation, feigned = agreement(s)
    possible = (
        inside(s)
        & ~near_step(s)
        & (_sums(clipped(s).astype(float)) <= MAX_CLIPPED * TEMPLATE_PX**2)
        & (correlation >= MIN_CORRELATION)
        & (feigned <= MAX_SYSTEMATIC_PX)
    )
    out = possible[y_px, x_px]
    out[out] = sigma_bound_px(s, x_px[out], y_px[out]) <= MAX_SIGMA_PX
    return out
