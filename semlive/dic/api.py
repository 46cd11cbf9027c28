"""Correlation of two arrays in one call."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid, grid_for
from semlive.data.settings import DicSettings
from semlive.dic.bands import correlate_tiled, is_large
from semlive.dic.correlate import correlate
from semlive.dic.reference import prepare
from semlive.errors import BadInput

MIN_EDGE_PX = 16

Image = NDArray[np.uint8] | NDArray[np.uint16]


def match(
    reference: Image,
    current: Image,
    grid: Grid | None = None,
    settings: DicSettings | None = None,
    *,
    mask: NDArray[np.bool_] | None = None,
) -> DisparityMap:
    """Measure the displacement of every grid point between two images: ``x_current = x_reference + u``, y likewise with v.

    With many current images of one reference, prepare it once: ``prepared = prepare(reference, grid, settings)``, then
    ``correlate(prepared, current, settings, reference_frame=0, current_frame=n)`` for each; it saves a quarter of the time.
    Frames beyond 4096 x 4096 px and grids beyond 400,000 points are processed in bands with bounded memory; images may be memory maps.

    Args:
        reference: (height, width) grey levels, uint8 or uint16.
        current: (height, width) grey levels, of the same size.
        grid: grid of the points, from `grid_for`; None covers the complete frame with subset and step of `settings`.
        settings: subset, step, tolerances; None: the defaults, with subset and step of the grid if it is given.
        mask: (height, width) True where the reference may be used; None: everywhere.

    Returns:
        u, v, their standard uncertainties, ZNCC and status at every point; values are undefined where `valid` is False.

    Raises:
        BadInput: the images have another form or different sizes, no subset fits, or the mask has another size.

    Example:
        >>> import numpy as np
        >>> from semlive.dic import match
        >>> squares = np.random.default_rng(1).integers(40, 216, (30, 40))
        >>> reference = np.kron(squares, np.ones((4, 4))).astype(np.uint8)
        >>> moved = np.roll(reference, (3, -2), axis=(0, 1))
        >>> result = match(reference, moved)
        >>> print(f"{np.median(result.u_px[result.valid]):.2f} {np.median(result.v_px[result.valid]):.2f}")
        -2.00 3.00
    """
    for name, image in (("reference", reference), ("current", current)):
        _check(name, image)
    (height, width), (h1, w1) = reference.shape, current.shape
    if (height, width) != (h1, w1):
        raise BadInput(f"the reference is {width} x {height} px but the current image {w1} x {h1} px: give two images of one size")
    if settings is None:
        settings = DicSettings(roi_px=None) if grid is None else DicSettings(subset_px=grid.subset_px, step_px=grid.step_px, roi_px=None)
    if grid is None:
        grid = grid_for(settings, width, height)
    else:
        _check_grid(grid, width, height)
    if is_large(reference.shape, grid):
        return correlate_tiled(reference, current, grid, settings, mask=mask)
    return correlate(prepare(reference, grid, settings, mask), current, settings, reference_frame=0, current_frame=1)


def _check(name: str, image: object) -> None:
    if not isinstance(image, np.ndarray):
        raise BadInput(f"the {name} image is a {type(image).__name__}, not an array: read the file first, or use the command semlive dic")
    if image.ndim != 2:
        raise BadInput(f"the {name} image has the shape {image.shape}, not (height, width): give one channel of grey levels")
    if image.dtype not in (np.uint8, np.uint16):
        raise BadInput(f"the {name} image has the type {image.dtype}, not uint8 or uint16: give the grey levels of the camera or detector")
    if min(image.shape) < MIN_EDGE_PX:
        raise BadInput(f"the {name} image is {image.shape[1]} x {image.shape[0]} px: give at least {MIN_EDGE_PX} x {MIN_EDGE_PX} px")


def _check_grid(grid: Grid, width: int, height: int) -> None:
    half = grid.subset_px // 2
    left, top = grid.x0_px - half, grid.y0_px - half
    right, bottom = grid.x0_px + (grid.nx - 1) * grid.step_px + half, grid.y0_px + (grid.ny - 1) * grid.step_px + half
    if min(left, top) < 0 or right >= width or bottom >= height:
        raise BadInput(
            f"the grid's subsets reach from ({left}, {top}) to ({right}, {bottom}) but the images are {width} x {height} px: "
            "make the grid with grid_for, which stays inside the frame"
        )
