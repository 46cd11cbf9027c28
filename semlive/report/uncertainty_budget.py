"""Uncertainty budget of a run."""

from __future__ import annotations

import numpy as np

from semlive.data.results import RunResult
from semlive.data.settings import AnalysisSettings

Row = tuple[str, str, str]
"""Quantity, its standard uncertainty, and the source of the uncertainty."""


def uncertainty_budget(result: RunResult, settings: AnalysisSettings) -> list[Row]:
    """Components of the uncertainty, from a single point to the elastic constants.

    Args:
        result: result of the run.
        settings: settings of the analysis.
    """
    estimate, last = result.estimate, result.summaries[-1]
    rows: list[Row] = [("displacement, one point", f"{estimate.noise_floor_px:.4f} px", "robust residual of the disparity")]
    valid = estimate.distortion.valid
    if valid.any():
        rms = float(np.sqrt(np.mean(estimate.distortion.sigma_px[valid] ** 2)))
        rows.append(("distortion", f"{rms:.4f} px", "rms over the field; noise and drift of the calibration"))
    rows.append(
        (
            "drift within a frame",
            f"{float(np.sqrt(np.mean(estimate.drift.sigma_px**2))):.4f} px",
            "rms, relative to the middle of the frame",
        )
    )
    if estimate.motions:
        shift = max(float(np.max(motion.shift_sigma_px)) for motion in estimate.motions)
        rows.append(("motion of the specimen", f"{shift:.4f} px", "the worst pair; includes drift during the motion"))
    starts = [info.start_sigma_s for decision in result.decisions for info in (decision.first, decision.second)]
    rows.append(("start of a scan", f"{max(starts):.3g} s", "the worst frame; included in mean strain"))
    for name in ("exx", "eyy", "exy"):
        whole = getattr(last.mean_sigma, name)
        added = 0.0 if last.systematic_sigma is None else getattr(last.systematic_sigma, name)
        noise = float(np.sqrt(max(whole**2 - added**2, 0.0)))
        parts = f"noise {1e6 * noise:.1f}, correction {1e6 * added:.1f}"
        rows.append((f"mean {name}, frame {last.frame}", f"{1e6 * whole:.1f} · 10⁻⁶", parts))
    if last.gauge_sigma is not None:
        gauge = max(last.gauge_sigma.exx, last.gauge_sigma.eyy)
        rows.append(
            (
                f"strain of one gauge, {last.vsg_px:.0f} px",
                f"{1e6 * gauge:.0f} · 10⁻⁶",
                "noise of its points, including the overlap of subsets",
            )
        )
    if result.elastic is not None:
        modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
        area = settings.specimen.area_mm2
        rows.append(
            (
                "Young's modulus",
                f"{modulus.sigma:.2g} GPa",
                f"strain and scatter of the load; add that of the cross-section of {area:g} mm²",
            )
        )
        rows.append(("Poisson's ratio", f"{ratio.sigma:.2g}", "strain alone; load and cross-section cancel"))
    if result.gage is not None:
        factor = 100 * settings.specimen.gage_factor_sigma
        rows.append(("DIC over gage", f"{result.gage.dic_over_gage.sigma:.4f}", f"strain, and {factor:.2g} % of the gage's factor"))
    rows.append(("magnification", "not included", "unknown translations do not determine it; use a calibrated pixel size"))
    return rows
