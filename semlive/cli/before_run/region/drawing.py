"""Region of interest and masks as values: defaults, checks, and the mask as an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semlive.errors import BadInput

Region = tuple[int, int, int, int]
"""First and last subset centre (x0, y0, x1, y1), px, inclusive."""

_SHIFT_MARGIN_PX = 40
"""Distance from the subsets at the edge of the default region to the edge of the frame: shifts of the calibration move points by this."""
_MAX_MASKS = 200
_MAX_CORNERS = 2000

_Coordinate = Annotated[float, Field(allow_inf_nan=False, ge=-1e5, le=1e5)]
_Polygon = Annotated[tuple[tuple[_Coordinate, _Coordinate], ...], Field(min_length=3, max_length=_MAX_CORNERS)]


class Drawing(BaseModel):
    """Answer of the page.

    Attributes:
        region_px: region of interest.
        masks_px: polygons (x, y) in px that must not be used; a rectangle has four corners.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    region_px: Region
    masks_px: Annotated[tuple[_Polygon, ...], Field(max_length=_MAX_MASKS)] = ()


@dataclass(frozen=True, slots=True)
class FrameSize:
    """Size of a test frame, and of a subset in it."""

    width_px: int
    height_px: int
    subset_px: int

    @property
    def largest_region(self) -> Region:
        """Region of all subsets that lie in the frame."""
        half = self.subset_px // 2
        return half, half, self.width_px - 1 - half, self.height_px - 1 - half


def default_region(size: FrameSize) -> Region:
    """Return the region of interest for a frame: all subsets, without a margin for the shifts of the calibration.

    Raises:
        BadInput: the frame is smaller than a subset.
    """
    x0, y0, x1, y1 = size.largest_region
    if x1 < x0 or y1 < y0:
        raise BadInput(
            f"a frame of {size.width_px} x {size.height_px} px is smaller than a subset of {size.subset_px} px; give a larger frame."
        )
    margin_x, margin_y = min(_SHIFT_MARGIN_PX, (x1 - x0) // 4), min(_SHIFT_MARGIN_PX, (y1 - y0) // 4)
    return x0 + margin_x, y0 + margin_y, x1 - margin_x, y1 - margin_y


def checked_region(region: Region, size: FrameSize) -> Region:
    """Return a region of interest that contains a point.

    Raises:
        BadInput: its corners are in the wrong order, or outside the frame.
    """
    x0, y0, x1, y1 = region
    if not (0 <= x0 <= x1 < size.width_px and 0 <= y0 <= y1 < size.height_px):
        raise BadInput(
            f"region {x0},{y0},{x1},{y1}: give x0, y0, x1, y1 with 0 <= x0 <= x1 < {size.width_px} and 0 <= y0 <= y1 < {size.height_px}."
        )
    return region


def parse_region(text: str, size: FrameSize) -> Region:
    """Return the region of interest of a text such as ``101,101,846,696``.

    Raises:
        BadInput: it has no four whole numbers, or they are no region in the frame.
    """
    try:
        x0, y0, x1, y1 = (int(part) for part in text.replace(" ", "").split(","))
    except ValueError:
        raise BadInput(f"region {text}: give four whole numbers x0,y0,x1,y1 in px.") from None
    return checked_region((x0, y0, x1, y1), size)


def parse_drawing(body: bytes, size: FrameSize) -> Drawing:
    """Return the answer of the page.

    Raises:
        BadInput: it is no drawing, or its region is not in the frame.
    """
    try:
        drawing = Drawing.model_validate_json(body)
    except ValidationError as error:
        raise BadInput(f"the drawing is not valid: {error.errors()[0]['msg']}.") from error
    checked_region(drawing.region_px, size)
    return drawing


def mask_png(drawing: Drawing, size: FrameSize) -> bytes:
    """Return the masks as a PNG of the size of the frame: 0 where it must not be used, as ``semlive dic --mask`` reads it."""
    used = np.full((size.height_px, size.width_px), 255, dtype=np.uint8)
    for polygon in drawing.masks_px:
        cv2.fillPoly(used, [np.rint(np.array(polygon)).astype(np.int32)], 0.0)
    return _png(used)


def shown_png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Return a frame as a PNG with 8 bit, its grey levels stretched from the 0.5th to the 99.5th percentile."""
    low, high = (float(level) for level in np.percentile(image, (0.5, 99.5)))
    scaled = (image.astype(np.float32) - low) * (255.0 / max(high - low, 1.0))
    return _png(np.clip(scaled, 0.0, 255.0).astype(np.uint8))


def _png(image: NDArray[np.uint8]) -> bytes:
    encoded, data = cv2.imencode(".png", image)
    if not encoded:
        raise BadInput("the image cannot be written as PNG; give a smaller frame.")
    return data.tobytes()
