"""Row registration: displacement of each scan row of a pair relative to the smooth disparity.

A subset of 43 rows reduces a 50 Hz wave at a row time of 0.107 s to a 60th, so disparity maps do not show displacements from row to row.
Here the current image is displaced by the smooth map, and the residual of each row and segment is fitted with a shift in x, a shift in
y and a grey offset.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, RowJitter, RowShifts
from semlive.dic.uncertainty import interpolation_noise_gain
from semlive.errors import BadInput
from semlive.kernels import images
from semlive.kernels import row_registration as kernel

Image = NDArray[np.uint8] | NDArray[np.uint16]
Plane = NDArray[np.float64]

LINEAR_PX = 0.25  # up to this shift one linearisation has an error of 0.2 %; above, a second one starts from the first result
MIN_PIXELS = 40  # smallest number of pixels of a segment
MAX_SIGMA_PX = 1.0  # a row or segment without contrast is not registered
DETREND_ROWS = 43  # slower changes are in the smooth map and do not count as jitter
# Instruments: derivative along one axis, smoothed along both. They pass 0.031 and 0.043 of the variance of noise (derivative of the
# spline 1.3, Sobel 0.19) and 96 % of the information in speckle of 6.7 px.
SMOOTH3 = np.array([1.0, 2.0, 1.0]) / 4.0
SMOOTH5 = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
ALONG_X = np.array([-1.0, -4.0, -5.0, 0.0, 5.0, 4.0, 1.0]) / 32.0
ALONG_Y = np.array([-1.0, -2.0, 0.0, 2.0, 1.0]) / 8.0


@dataclass(frozen=True, slots=True)
class _Normal:
    """Normal equations: products of the instruments x, y and the difference d about their means, and degrees of freedom."""

    xx: Plane
    xy: Plane
    yy: Plane
    xd: Plane
    yd: Plane
    dd: Plane
    pixels: Plane
    degrees: Plane

    def over_segments(self) -> _Normal:
        """One set of equations for each row; every segment has its own offset."""
        return _Normal(*(getattr(self, field.name).sum(axis=1) for field in fields(self)))


@dataclass(frozen=True, slots=True)
class _Shift:
    """Solutions of normal equations; zero where not valid."""

    u: Plane
    v: Plane
    sigma_u: Plane
    sigma_v: Plane
    valid: NDArray[np.bool_]


def register_rows(
    reference: Image, current: Image, disparity: DisparityMap, *, segments: int = 6, mask: NDArray[np.bool_] | None = None
) -> RowShifts:
    """Measure the shift of every row of the reference, and of its segments, relative to the smooth disparity of the pair.

    The gradients are smoothed, and scaled by a regression on the derivative of the spline that is corrected for noise (errors in
    variables); an ordinary fit loses 11 to 40 % of the amplitude at image noise of 5 to 10 %. Outside the grid of the disparity map
    its affine part is extrapolated and its residual is constant.

    Args:
        reference: (height, width) uint8 or uint16, the frame of the rows.
        current: (height, width), of the same size and type.
        disparity: map of these two frames, from `correlate`.
        segments: number of segments along x.
        mask: (height, width) True where the reference may be used; None: everywhere.

    Raises:
        BadInput: the sizes differ, fewer than three POI converged, or the segments would be too short.
        ValueError: the images have another form.
    """
    f, g = images.to_float32_grey(reference), images.to_float32_grey(current)
    _check(f, g, disparity, segments, mask)
    height, width = f.shape
    gradients = smoothed_gradients(f)
    coefficients = images.coefficients(g)
    usable = (reference > 0) & (reference < np.iinfo(reference.dtype).max)
    if mask is not None:
        usable &= mask
    edges = np.linspace(kernel.MARGIN_PX, width - kernel.MARGIN_PX, segments + 1).round().astype(np.int64)
    (u_affine, u_nodes), (v_affine, v_nodes) = (_smooth_field(disparity, values) for values in (disparity.u_px, disparity.v_px))
    gain = _blurred_sd(f) / max(_blurred_sd(g), 1e-6)
    lattice = (disparity.grid.x0_px, disparity.grid.y0_px, disparity.grid.step_px)
    passed_xy, passed_y = _passed(disparity)
    base = np.zeros((2, height))
    while True:
        sums = kernel.sum_rows(
            f, *gradients, coefficients, usable, edges, (u_nodes, v_nodes), (u_affine, v_affine), lattice, (base[0], base[1]), gain
        )
        pieces = _normal(sums)
        combined = pieces.over_segments()
        noise = _noise_grey(combined, passed_xy)
        scale = gradient_scales(f, *gradients, noise)
        variance = noise**2 * (1.0 + passed_y)
        rows = _solve(combined, scale, variance)
        if base.any() or max(np.abs(rows.u).max(), np.abs(rows.v).max()) <= LINEAR_PX:
            break
        base = np.stack([rows.u, rows.v])
    return _row_shifts(disparity, edges, sums, base, rows, _solve(pieces, scale, variance), noise, passed_y)


def row_jitter(shifts: RowShifts) -> RowJitter:
    """White jitter of the rows of one frame: variance of the row shifts within a subset minus that of the noise.

    Both frames are assumed to have equal jitter. At fractional disparity along y, interpolation attenuates the jitter of the current
    frame, which is corrected.

    Args:
        shifts: from `register_rows`.
    """
    u, sigma_u = _excess(shifts.u_px[shifts.valid], shifts.sigma_u_px[shifts.valid], shifts.interpolation_noise_gain)
    v, sigma_v = _excess(shifts.v_px[shifts.valid], shifts.sigma_v_px[shifts.valid], shifts.interpolation_noise_gain)
    return RowJitter(sd_u_px=u, sd_v_px=v, sigma_u_px=sigma_u, sigma_v_px=sigma_v)


def _excess(values: Plane, sigma: Plane, passed: float) -> tuple[float, float]:
    if values.size < 2 * DETREND_ROWS:
        return 0.0, float("inf")
    window = np.ones(DETREND_ROWS) / DETREND_ROWS
    detrended = values[DETREND_ROWS // 2 : -(DETREND_ROWS // 2)] - np.convolve(values, window, mode="valid")
    total = float(np.mean(detrended**2)) * DETREND_ROWS / (DETREND_ROWS - 1)
    frames = 1.0 + passed
    sd = np.sqrt(max(total - float(np.mean(sigma**2)), 0.0) / frames)
    variance_sigma = total * np.sqrt(2.0 / detrended.size) / frames
    return float(sd), float(min(variance_sigma / (2.0 * sd) if sd > 0.0 else np.inf, np.sqrt(variance_sigma)))


def smoothed_gradients(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smoothed derivatives along x and y, (height, width) each."""
    along_x = cv2.sepFilter2D(image, cv2.CV_32F, ALONG_X, SMOOTH3)
    along_y = cv2.sepFilter2D(image, cv2.CV_32F, SMOOTH5, ALONG_Y)
    return np.asarray(along_x, dtype=np.float32), np.asarray(along_y, dtype=np.float32)


def gradient_scales(
    image: NDArray[np.float32], along_x: NDArray[np.float32], along_y: NDArray[np.float32], noise_grey: float
) -> tuple[float, float]:
    """Factors from the instruments to the best linear estimate of the true derivatives: regression corrected for noise.

    Args:
        image: (height, width) grey levels.
        along_x: from `smoothed_gradients`.
        along_y: from `smoothed_gradients`.
        noise_grey: standard deviation of the noise of the image.
    """
    spline_x = _spline_stencil(ALONG_X.size // 2) @ ALONG_X * SMOOTH3[1]
    spline_y = _spline_stencil(ALONG_Y.size // 2) @ ALONG_Y * SMOOTH5[2]
    x = _scale(image[3:-3:4], along_x[3:-3:4], float(spline_x) * noise_grey**2)
    y = _scale(image[:, 3:-3:4].T, along_y[:, 3:-3:4].T, float(spline_y) * noise_grey**2)
    return x, y


def _scale(lines: NDArray[np.float32], instrument: NDArray[np.float32], noise_part: float) -> float:
    derivative = images.spline_line_derivative(np.ascontiguousarray(lines))[:, 2:-2]
    smooth = instrument[:, 3:-3]
    energy = float(np.mean(smooth**2))
    return max(float(np.mean(smooth * derivative)) - noise_part, 0.05 * energy) / energy if energy > 0.0 else 1.0


def _spline_stencil(half_width: int) -> Plane:
    """Weights of the derivative of the interpolating cubic spline at a sample, for distances -half_width to half_width."""
    pole = np.sqrt(3.0) - 2.0
    k = np.arange(-half_width, half_width + 1)
    return 0.5 * np.sqrt(3.0) * (pole ** np.abs(k - 1) - pole ** np.abs(k + 1))


def _check(f: NDArray, g: NDArray, disparity: DisparityMap, segments: int, mask: NDArray | None) -> None:
    (height, width), (h1, w1) = f.shape, g.shape
    if (height, width) != (h1, w1):
        raise BadInput(f"the reference is {width} x {height} px but the current frame {w1} x {h1} px: give frames of one size")
    if mask is not None and mask.shape != (height, width):
        raise BadInput(f"the mask is {mask.shape[1]} x {mask.shape[0]} px but the frames {width} x {height} px: give a mask of their size")
    most = (width - 2 * kernel.MARGIN_PX) // MIN_PIXELS
    if not 1 <= segments <= most:
        raise BadInput(f"rows of {width} px can have 1 to {most} segments of {MIN_PIXELS} px, not {segments}: use fewer")
    if int(disparity.valid.sum()) < 3:
        raise BadInput("fewer than three points of the disparity map converged: row registration needs frames that match")


def _smooth_field(disparity: DisparityMap, values: Plane) -> tuple[Plane, NDArray[np.float32]]:
    """Affine part (constant, slopes along x and y) and residual at the nodes; failed POI get the mean of their neighbours."""
    x, y = disparity.grid.mesh()
    valid = disparity.valid
    x_scale, y_scale = x - x.mean(), y - y.mean()
    design = np.column_stack([np.ones(int(valid.sum())), x_scale[valid], y_scale[valid]])
    c = np.linalg.lstsq(design, values[valid], rcond=1e-9)[0]
    residual = np.where(valid, values - (c[0] + c[1] * x_scale + c[2] * y_scale), 0.0)
    if not valid.all():
        sd = 4.0
        weight = cv2.GaussianBlur(valid.astype(np.float64), (0, 0), sd, borderType=cv2.BORDER_CONSTANT)
        filled = cv2.GaussianBlur(residual, (0, 0), sd, borderType=cv2.BORDER_CONSTANT) / (weight + 1e-6)
        residual = np.where(valid, residual, filled)
    affine = np.array([c[0] - c[1] * x.mean() - c[2] * y.mean(), c[1], c[2]])
    return affine, np.ascontiguousarray(residual, dtype=np.float32)


def _blurred_sd(image: NDArray[np.float32]) -> float:
    """Contrast of the smoothed image, with little noise."""
    return float(np.std(cv2.sepFilter2D(image, cv2.CV_32F, SMOOTH5, SMOOTH5)))


def _passed(disparity: DisparityMap) -> tuple[float, float]:
    """Mean fractions of the noise variance of the current frame that interpolation passes: along both axes, and along y."""
    u, v = disparity.u_px[disparity.valid], disparity.v_px[disparity.valid]
    none = np.zeros_like(u)
    across_rows = interpolation_noise_gain(v, none, none, 1)
    return float(np.mean(interpolation_noise_gain(u, none, none, 1) * across_rows)), float(np.mean(across_rows))


def _normal(sums: Plane) -> _Normal:
    k = kernel
    n = sums[..., k.COUNT]
    sufficient = n >= MIN_PIXELS
    s = np.where(sufficient[..., None], sums, 0.0)
    over_n = np.where(sufficient, 1.0 / np.maximum(n, 1.0), 0.0)

    def about_means(product: int, a: int, b: int) -> Plane:
        return s[..., product] - s[..., a] * s[..., b] * over_n

    return _Normal(
        xx=about_means(k.XX, k.X, k.X), xy=about_means(k.XY, k.X, k.Y), yy=about_means(k.YY, k.Y, k.Y),
        xd=about_means(k.XD, k.X, k.D), yd=about_means(k.YD, k.Y, k.D), dd=about_means(k.DD, k.D, k.D),
        pixels=s[..., k.COUNT], degrees=np.where(sufficient, n - 1.0, 0.0),
    )  # fmt: skip


def _noise_grey(rows: _Normal, passed: float) -> float:
    """Noise of one frame from the median residual of the rows, which contains the noise of both frames after interpolation."""
    determinant = rows.xx * rows.yy - rows.xy**2
    use = (rows.degrees > MIN_PIXELS) & (determinant > 0.0)
    if not use.any():
        return 0.0
    r = _Normal(*(getattr(rows, field.name)[use] for field in fields(rows)))
    explained = (r.yy * r.xd**2 - 2.0 * r.xy * r.xd * r.yd + r.xx * r.yd**2) / determinant[use]
    return float(np.sqrt(max(float(np.median((r.dd - explained) / (r.degrees - 2.0))), 1.0 / 12.0) / (1.0 + passed)))


def _solve(equations: _Normal, scale: tuple[float, float], variance: float) -> _Shift:
    """Shifts from the normal equations; a shift of +r reduces the displaced current image by gradient times r."""
    e = equations
    sx, sy = scale
    xx, xy, yy = e.xx * sx * sx, e.xy * sx * sy, e.yy * sy * sy
    determinant = xx * yy - xy * xy
    safe = determinant > 1e-6 * np.maximum(xx * yy, 1e-30)
    over = np.where(safe, 1.0 / np.where(safe, determinant, 1.0), 0.0)
    sigma_u = np.sqrt(variance * yy * over)
    sigma_v = np.sqrt(variance * xx * over)
    valid = safe & (np.maximum(sigma_u, sigma_v) <= MAX_SIGMA_PX)
    u = -(yy * e.xd * sx - xy * e.yd * sy) * over
    v = -(xx * e.yd * sy - xy * e.xd * sx) * over
    u, v, sigma_u, sigma_v = (np.where(valid, values, 0.0) for values in (u, v, sigma_u, sigma_v))
    return _Shift(u, v, sigma_u, sigma_v, valid)


def _row_shifts(
    disparity: DisparityMap,
    edges: NDArray[np.int64],
    sums: Plane,
    base: Plane,
    rows: _Shift,
    pieces: _Shift,
    noise: float,
    passed: float,
) -> RowShifts:
    height = sums.shape[0]
    inside = slice(kernel.MARGIN_PX, height - kernel.MARGIN_PX)
    y = np.arange(height, dtype=np.int64)
    count = np.maximum(sums[:, :, kernel.COUNT].sum(axis=1), 1.0)
    base_u, base_v = base[:, :, None]
    return RowShifts(
        reference=disparity.reference,
        current=disparity.current,
        row_px=y[inside],
        current_row_px=(y + sums[:, :, kernel.V].sum(axis=1) / count)[inside],
        edges_px=edges,
        u_px=(rows.u + np.where(rows.valid, base[0], 0.0))[inside],
        v_px=(rows.v + np.where(rows.valid, base[1], 0.0))[inside],
        sigma_u_px=rows.sigma_u[inside],
        sigma_v_px=rows.sigma_v[inside],
        valid=rows.valid[inside],
        segment_u_px=np.where(pieces.valid, pieces.u + base_u, 0.0)[inside],
        segment_v_px=np.where(pieces.valid, pieces.v + base_v, 0.0)[inside],
        segment_sigma_u_px=pieces.sigma_u[inside],
        segment_sigma_v_px=pieces.sigma_v[inside],
        segment_valid=pieces.valid[inside],
        noise_grey=noise,
        interpolation_noise_gain=passed,
    )
