"""Recommended settings of the correlation for one frame, and the displacement noise expected with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class RowStructure:
    """Differences between the rows of a frame that its pattern does not explain.

    Attributes:
        offset_grey: standard deviation of the grey offset of a row, grey levels.
        shift_px: standard deviation of the shift of a row along x, px.
    """

    offset_grey: float
    shift_px: float


@dataclass(frozen=True, slots=True)
class CorrelationChoice:
    """Recommended method, subset and step for one frame.

    Attributes:
        method: ``subset``, or ``global`` where subsets of acceptable size have too little texture or rows differ too much.
        subset_px: recommended edge of a subset; with ``global``, the largest subset of acceptable resolution.
        step_px: recommended distance of POI.
        sigma_u_px: expected standard deviation of u between two such frames from white image noise, median over the frame; with ``global``,
            that of a window of this size, without regularisation. Zero without a pattern.
        sigma_v_px: the same of v.
        usable_fraction: fraction of the POI with sufficient contrast for such subsets.
        rows: differences between rows.
        reason: why this method, with the figures that decide.
    """

    method: Literal["subset", "global"]
    subset_px: int
    step_px: int
    sigma_u_px: float
    sigma_v_px: float
    usable_fraction: float
    rows: RowStructure
    reason: str
