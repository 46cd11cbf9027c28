"""Text and JSON of the recommended correlation, in `semlive plan` and `semlive doctor`."""

from __future__ import annotations

from dataclasses import asdict

from semlive.service.planning.recommendation import Recommendation


def recommendation_json(recommended: Recommendation | None) -> dict[str, object] | None:
    """The recommendation as a JSON object; None without a test frame."""
    if recommended is None:
        return None
    choice, gauge = recommended.choice, recommended.gauge
    return {
        "method": choice.method,
        "subset_px": choice.subset_px,
        "step_px": choice.step_px,
        "displacement_sigma_px": [choice.sigma_u_px, choice.sigma_v_px] if max(choice.sigma_u_px, choice.sigma_v_px) > 0.0 else None,
        "strain_sigma": None if gauge is None else asdict(gauge),
        "usable_fraction": choice.usable_fraction,
        "row_offset_grey": choice.rows.offset_grey,
        "row_shift_px": choice.rows.shift_px,
        "reason": choice.reason,
    }


def recommendation_rows(recommended: Recommendation) -> list[tuple[str, str]]:
    """Name and text of each part of the recommendation."""
    choice, gauge = recommended.choice, recommended.gauge
    rows = [("recommended", f"method {choice.method}, subset {choice.subset_px} px, step {choice.step_px} px: {choice.reason}")]
    if max(choice.sigma_u_px, choice.sigma_v_px) > 0.0:
        text = f"from image noise: displacement {choice.sigma_u_px:.4f} px along x, {choice.sigma_v_px:.4f} px along y"
        if gauge is not None:
            text += f"; strain exx {gauge.sigma.exx:.1e}, eyy {gauge.sigma.eyy:.1e}, exy {gauge.sigma.exy:.1e} over {gauge.vsg_px} px"
        rows.append(("noise with it", text))
    return rows
