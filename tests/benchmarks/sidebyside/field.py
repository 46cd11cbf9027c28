"""The paper's points among those of a run: more of the picture may be correlated than is compared."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TypeVar

import numpy as np

from semlive.data.disparity import DisparityMap
from semlive.data.drift import DistortionField
from semlive.data.grid import Grid
from semlive.data.results import RunResult
from semlive.data.strain import Displacement

PAPER_POINTS = Grid(101, 101, 5, 150, 120, 43)

OnGrid = TypeVar("OnGrid", Displacement, DisparityMap, DistortionField)


def on_papers_points(one: OnGrid) -> OnGrid:
    """The part of a field that lies at the paper's points; the field as it is where it does not hold all of these."""
    place = _place(one.grid)
    if place is None:
        return one
    named = {item.name: getattr(one, item.name) for item in fields(one)}
    inside = {
        name: np.ascontiguousarray(value[place])
        for name, value in named.items()
        if isinstance(value, np.ndarray) and value.shape[:2] == one.grid.shape
    }
    return type(one)(**{**named, **inside, "grid": PAPER_POINTS})


def compared(result: RunResult) -> RunResult:
    """A run's result at the paper's points; results for complete fields, such as mean strain, stay those of all of its own points."""
    frames = tuple(replace(one, displacement=on_papers_points(one.displacement)) for one in result.frames)
    estimate = replace(result.estimate, distortion=on_papers_points(result.estimate.distortion))
    return replace(result, frames=frames, estimate=estimate)


def _place(grid: Grid) -> tuple[slice, slice] | None:
    requests = PAPER_POINTS
    if (grid.step_px, grid.subset_px) != (requests.step_px, requests.subset_px):
        return None
    row, y_remainder = divmod(requests.y0_px - grid.y0_px, grid.step_px)
    column, x_remainder = divmod(requests.x0_px - grid.x0_px, grid.step_px)
    whole = row >= 0 and column >= 0 and row + requests.ny <= grid.ny and column + requests.nx <= grid.nx
    if y_remainder or x_remainder or not whole:
        return None
    return slice(row, row + requests.ny), slice(column, column + requests.nx)
