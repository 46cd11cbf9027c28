"""Grid of the points of interest (POI) of a frame."""

from __future__ import annotations

from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.errors import BadInput


def grid_for(settings: DicSettings, width_px: int, height_px: int) -> Grid:
    """Return the grid of all POI with centres in the region of interest and subsets in the frame.

    The first POI is the first corner of the region, moved inwards by multiples of the step until its subset lies in the frame.

    Args:
        settings: subset, step and region.
        width_px: frame width.
        height_px: frame height.

    Raises:
        BadInput: no POI fits.
    """
    half = settings.subset_px // 2
    step = settings.step_px
    x0, y0, x1, y1 = settings.roi_px or (half, half, width_px - 1 - half, height_px - 1 - half)
    x0 += max(0, -((x0 - half) // step)) * step
    y0 += max(0, -((y0 - half) // step)) * step
    nx = (min(x1, width_px - 1 - half) - x0) // step + 1
    ny = (min(y1, height_px - 1 - half) - y0) // step + 1
    if nx < 1 or ny < 1:
        region = "the complete frame" if settings.roi_px is None else f"roi {','.join(map(str, settings.roi_px))}"
        raise BadInput(
            f"no subset of {settings.subset_px} px fits into {region} of a {width_px} x {height_px} px frame: "
            "enlarge the roi or reduce the subset"
        )
    return Grid(x0_px=x0, y0_px=y0, step_px=step, nx=nx, ny=ny, subset_px=settings.subset_px)
