"""Strain of a frame as scalars: mean with uncertainty, and scatter."""

from __future__ import annotations

import numpy as np

from semlive.data.settings import StrainSettings
from semlive.data.strain import Displacement, StrainField, StrainSummary, Tensor2
from semlive.errors import IllPosed
from semlive.mechanics.gauge_noise import gauge_sigma

ZERO_TENSOR = Tensor2(0.0, 0.0, 0.0)
DEFAULT_SETTINGS = StrainSettings()


def summary(
    displacement: Displacement,
    field: StrainField,
    noise_px: float | None = None,
    systematic: Tensor2 = ZERO_TENSOR,
    settings: StrainSettings = DEFAULT_SETTINGS,
) -> StrainSummary:
    """Mean strain over the valid grid by the best affine fit, its uncertainty, and the scatter of the field.

    The joint fit to all points has the smallest noise of all mean estimates. For n points whose noise sigma is correlated over a subset,
    ``sigma_e = sigma sqrt(12 / N_eff) / L`` with N_eff = n (step / subset)^2 (272 of the 18,000 points of the paper).

    Args:
        displacement: corrected displacement from frame 0.
        field: its strain field.
        noise_px: standard deviation of one POI, per component, px; None uses the standard uncertainty reported by the DIC.
        systematic: standard uncertainty of the mean added by the correction.
        settings: settings of the strain fit.

    Raises:
        IllPosed: too few valid points.
    """
    gradient, spread = mean_gradient(displacement)
    grid, valid = displacement.grid, displacement.valid
    overlap = max(grid.subset_px, grid.step_px) / grid.step_px
    if noise_px is None:
        both = np.concatenate((displacement.sigma_u_px[valid], displacement.sigma_v_px[valid]))
        noise_px = float(np.sqrt(np.mean(both**2)))
    along_x, along_y = noise_px * overlap / spread
    random = Tensor2(along_x, along_y, 0.5 * float(np.hypot(along_x, along_y)))
    mean_sigma = Tensor2(
        float(np.hypot(random.exx, systematic.exx)),
        float(np.hypot(random.eyy, systematic.eyy)),
        float(np.hypot(random.exy, systematic.exy)),
    )
    mean = Tensor2(float(gradient[0, 0]), float(gradient[1, 1]), 0.5 * float(gradient[0, 1] + gradient[1, 0]))
    inside = field.valid
    scatter = (float(np.std(component[inside])) if inside.any() else 0.0 for component in (field.exx, field.eyy, field.exy))
    one_gauge = gauge_sigma(displacement, field, settings, systematic)
    vsg_px = float(grid.vsg_px(field.window_points))
    return StrainSummary(displacement.frame, mean, mean_sigma, Tensor2(*scatter), vsg_px, one_gauge, systematic)


def mean_gradient(displacement: Displacement) -> tuple[np.ndarray, np.ndarray]:
    """(2, 2) best gradient [[du/dx, du/dy], [dv/dx, dv/dy]] over the valid grid, and (2,) root of the points' spread along x and y.

    Raises:
        IllPosed: the valid points do not span an area.
    """
    x, y = displacement.grid.mesh()
    valid = displacement.valid
    if valid.sum() >= 3:
        position = np.stack((x[valid], y[valid]))
        position -= position.mean(axis=1, keepdims=True)
        normal = position @ position.T
        if np.linalg.cond(normal) < 1e6:
            moved = np.stack((displacement.u_px[valid], displacement.v_px[valid]))
            moved = moved - moved.mean(axis=1, keepdims=True)
            inverse = np.linalg.inv(normal)
            return moved @ position.T @ inverse, 1.0 / np.sqrt(np.diag(inverse))
    count = int(valid.sum())
    raise IllPosed(f"only {count} points of frame {displacement.frame} were measured, too few for a mean strain: check focus and contrast")


def average_of_pair(first: StrainSummary, second: StrainSummary) -> StrainSummary:
    """Mean of the two frames of a pair, with the number of the first. Their errors are mostly common, so the uncertainty is not reduced."""
    mean, sigma, sd = (
        Tensor2(*(0.5 * (getattr(a, c) + getattr(b, c)) for c in ("exx", "eyy", "exy")))
        for a, b in ((first.mean, second.mean), (first.mean_sigma, second.mean_sigma), (first.sd, second.sd))
    )
    return StrainSummary(first.frame, mean, sigma, sd, first.vsg_px)
