"""Strain by other local fits than a plane over a square: weights, second order, Green-Lagrange; noise as a function of gauge length."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from semlive.data.settings import StrainSettings
from semlive.data.strain import Displacement, StrainField, Tensor2
from semlive.errors import IllPosed
from semlive.mechanics.strain import MIN_FILL, strain

Field = NDArray[np.float64]
_TERMS = {1: ((0, 0), (1, 0), (0, 1)), 2: ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))}
GAUSSIAN_SD = 0.5  # in units of the half width of the window: a point at its edge has the weight e^-2
MAX_CONDITION = 1e3  # of the normal matrix in units of the half width of the window; complete windows have below 40
BUTTERWORTH_ORDER = 2


def strain_field(displacement: Displacement, window_points: int, settings: StrainSettings) -> StrainField:
    """Strain according to the settings. With default settings the result is bit-identical to `strain`.

    Raises:
        IllPosed: the window does not fit the grid.
    """
    field = strain(displacement, window_points)  # refuses windows that do not fit
    if settings == StrainSettings():
        return field
    if settings.butterworth_points is not None:
        displacement = butterworth(displacement, settings.butterworth_points)
    (ux, uy, vx, vy), valid = gradients(displacement, window_points, settings)
    valid &= field.valid
    exx, eyy, exy = ux, vy, 0.5 * (uy + vx)
    if settings.measure == "green_lagrange":
        exx, eyy, exy = exx + 0.5 * (ux**2 + vx**2), eyy + 0.5 * (uy**2 + vy**2), exy + 0.5 * (ux * uy + vx * vy)
    exx, eyy, exy = (np.where(valid, component, 0.0) for component in (exx, eyy, exy))
    for component in (exx, eyy, exy, valid):
        component.setflags(write=False)
    return StrainField(displacement.frame, displacement.grid, window_points, exx, eyy, exy, valid)


def gradients(
    displacement: Displacement, window_points: int, settings: StrainSettings
) -> tuple[tuple[Field, Field, Field, Field], NDArray[np.bool_]]:
    """du/dx, du/dy, dv/dx, dv/dy (ny, nx) by a polynomial over the window of each POI, and the mask of valid results.

    Masked POI and those outside the grid are excluded. A window less than half full, or with points that do not determine the polynomial (a
    second-order one needs more points at an edge), is invalid.
    """
    half = window_points // 2
    lag = np.arange(-half, half + 1) / half  # in units of the half width, which keeps the normal matrix well scaled
    kernel = np.ones(window_points) if settings.weights == "uniform" else np.exp(-0.5 * (lag / GAUSSIAN_SD) ** 2)
    weight, terms = displacement.valid.astype(np.float64), _TERMS[settings.order]
    powers = {(a + c, b + d) for a, b in terms for c, d in terms}
    moment = {power: _sum(weight, kernel * lag ** power[0], kernel * lag ** power[1]) for power in powers}
    normal = np.stack([np.stack([moment[a + c, b + d] for c, d in terms], axis=-1) for a, b in terms], axis=-2)
    values = [
        np.stack([_sum(component * weight, kernel * lag**a, kernel * lag**b) for a, b in terms], axis=-1)
        for component in (displacement.u_px, displacement.v_px)
    ]
    eigenvalues = np.linalg.eigvalsh(normal)
    count = _sum(weight, np.ones(window_points), np.ones(window_points))
    window = _sum(np.ones_like(weight), np.ones(window_points), np.ones(window_points))
    enough = (count >= np.maximum(MIN_FILL * window, len(terms) + 1)) & (eigenvalues[..., 0] * MAX_CONDITION > eigenvalues[..., -1])
    valid = displacement.valid & enough
    normal[~valid] = np.eye(len(terms))
    solved = np.linalg.solve(normal, np.stack(values, axis=-1)) / (half * displacement.grid.step_px)
    slopes = (solved[..., 1, 0], solved[..., 2, 0], solved[..., 1, 1], solved[..., 2, 1])
    ux, uy, vx, vy = (np.where(valid, slope, 0.0) for slope in slopes)
    return (ux, uy, vx, vy), valid


def whole_window(window_points: int, settings: StrainSettings) -> Field:
    """(2, window, window) weights of the POI of a complete window in its slope along x and along y, per POI."""
    half = window_points // 2
    lag = np.arange(-half, half + 1) / half
    kernel = np.ones(window_points) if settings.weights == "uniform" else np.exp(-0.5 * (lag / GAUSSIAN_SD) ** 2)
    x, y = np.meshgrid(lag, lag)
    weight = np.outer(kernel, kernel).ravel()
    columns = np.stack([(x**a * y**b).ravel() for a, b in _TERMS[settings.order]], axis=1)
    solved = np.linalg.solve(columns.T @ (weight[:, None] * columns), columns.T * weight)
    return solved[1:3].reshape(2, window_points, window_points) / half


def butterworth(displacement: Displacement, cutoff_points: float) -> Displacement:
    """Displacement after a low-pass filter of second order; waves of `cutoff_points` POI lose half their power.

    The best plane is subtracted before and added after filtering, and edges are mirrored, so a homogeneous strain is unchanged.
    Missing points
    are handled by normalised convolution.
    """
    grid, valid = displacement.grid, displacement.valid
    if not cutoff_points > 2:
        raise IllPosed(f"a filter that cuts at {cutoff_points} points cuts at nothing: give more than 2")
    if valid.sum() < 3:
        raise IllPosed(f"only {int(valid.sum())} points of frame {displacement.frame} were measured, too few to filter")
    wave_x, wave_y = (0.5 * np.arange(count) / count for count in (grid.nx, grid.ny))
    response = 1.0 / (1.0 + (np.hypot(wave_y[:, None], wave_x[None, :]) * cutoff_points) ** (2 * BUTTERWORTH_ORDER))
    gain = np.sqrt(response)
    plane = np.stack((np.ones(grid.shape), *grid.mesh()), axis=-1)
    filled = _passed(valid.astype(np.float64), gain)
    passed = []
    for component in (displacement.u_px, displacement.v_px):
        flat = plane @ np.linalg.lstsq(plane[valid], component[valid], rcond=None)[0]
        smooth = _passed(np.where(valid, component - flat, 0.0), gain) / np.maximum(filled, 0.1)
        passed.append(np.where(valid, smooth + flat, 0.0))
        passed[-1].setflags(write=False)
    return Displacement(displacement.frame, grid, passed[0], passed[1], displacement.sigma_u_px, displacement.sigma_v_px, valid)


@dataclass(frozen=True, slots=True)
class GageNoise:
    """Scatter of strain at one gauge length.

    Attributes:
        window_points: edge of the gauge in POI.
        vsg_px: gauge length including the subset, px.
        sd: standard deviation over the field after removal of the best affine field.
    """

    window_points: int
    vsg_px: float
    sd: Tensor2


def noise_curve(displacement: Displacement, windows: Iterable[int]) -> tuple[GageNoise, ...]:
    """Scatter of strain as a function of gauge length, from a frame with uniform or linear strain; windows that do not fit are left out."""
    grid, curve = displacement.grid, []
    for window in windows:
        if window > min(grid.nx, grid.ny):
            continue
        field = strain(displacement, window)
        plane = np.stack((np.ones(grid.shape), *grid.mesh()), axis=-1)[field.valid]
        if len(plane) > 6:
            values = np.stack([component[field.valid] for component in (field.exx, field.eyy, field.exy)], axis=1)
            residual = values - plane @ np.linalg.lstsq(plane, values, rcond=None)[0]
            sd = np.sqrt(np.sum(residual**2, axis=0) / (len(plane) - 3))
            curve.append(GageNoise(window, float(grid.vsg_px(window)), Tensor2(*(float(value) for value in sd))))
    return tuple(curve)


def _passed(values: Field, gain: Field) -> Field:
    return np.asarray(idctn(np.asarray(dctn(values, norm="ortho")) * gain, norm="ortho"))


def _sum(value: Field, along_x: Field, along_y: Field) -> Field:
    """Sum over the window of each POI of ``value * along_x * along_y``; nothing lies beyond the edge."""
    half, (ny, nx) = len(along_x) // 2, value.shape
    padded = np.pad(value, half)
    rows = sum(value * padded[:, i : i + nx] for i, value in enumerate(along_x))
    return np.asarray(sum(value * np.asarray(rows)[i : i + ny] for i, value in enumerate(along_y)))
