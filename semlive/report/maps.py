"""Maps of a field over the SEM image: lengths in µm, one colour range for all maps of a quantity, and a scale bar."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from semlive.data.grid import Grid

Field = NDArray[np.float64]
MAX_IMAGE_PX = 1024
"""Longest edge of the image in a figure of its own; a larger one is reduced by averaging."""
MAX_PANEL_PX = 400
"""Longest edge of a field in a panel of a sheet: 200 dpi if the panel is 50 mm wide."""
MAX_UNDER_PX = 220
"""Longest edge of the image under a map; twenty of them are in a report, and noise is not compressed."""
BAR_FRACTION = 0.22
"""Largest length of the scale bar as a fraction of the width of the image."""
ROUND_STEPS = [1, 2, 2.5, 5, 10]
MARGIN_FRACTION = 0.1
"""Width of the image around a map, as a fraction of the width of the map."""
_OUTERMOST_PERCENT = 1.0
_GREYS = colormaps["gray"].resampled(48)
"""As many grey levels as can be seen; fewer levels are smaller files."""
_DIVERGING_SHARE = 0.2
"""A range is symmetric about zero if at least this share of it lies on either side."""
_OPACITY = 0.85


@dataclass(frozen=True, slots=True)
class ImageScale:
    """Unit of lengths on the specimen.

    Attributes:
        um_per_px: edge of a pixel, µm; None if it is not recorded, then lengths are in px.
    """

    um_per_px: float | None = None

    @property
    def unit(self) -> str:
        """``µm`` or ``px``."""
        return "px" if self.um_per_px is None else "µm"

    @property
    def factor(self) -> float:
        """Length of a pixel in `unit`."""
        return 1.0 if self.um_per_px is None else self.um_per_px


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """The SEM image under a map.

    Attributes:
        grey: (height, width) grey levels, reduced.
        width_px: width of the full image.
        height_px: height of the full image.
    """

    grey: NDArray[np.float32]
    width_px: int
    height_px: int


@dataclass(frozen=True, slots=True)
class ColourRange:
    """Colours of all maps of a quantity.

    Attributes:
        low: value of the first colour.
        high: value of the last colour.
        diverging: zero is in the middle and white.
    """

    low: float
    high: float
    diverging: bool

    @property
    def colours(self) -> str:
        """Name of the colour map: perceptually ordered, and distinct for colour-blind readers."""
        return "RdBu_r" if self.diverging else "cividis"


def background_of(image: NDArray[np.uint8] | NDArray[np.uint16]) -> Background:
    """The image for figures, with a longest edge of at most `MAX_IMAGE_PX`."""
    height, width = image.shape
    return Background(_averaged(image.astype(np.float32), MAX_IMAGE_PX), width, height)


def _averaged(image: NDArray[np.float32], longest_px: int) -> NDArray[np.float32]:
    """Reduce an image by averaging square blocks until its longest edge is at most `longest_px`."""
    block = -(-max(image.shape) // longest_px)
    rows, columns = (size // block for size in image.shape)
    return image[: rows * block, : columns * block].reshape(rows, block, columns, block).mean(axis=(1, 3))


def colour_range(values: Iterable[Field]) -> ColourRange:
    """Range of the inner 98 % of all values, extended to round numbers; symmetric if values lie on both sides of zero.

    Args:
        values: measured values of each map; maps without a value are ignored.
    """
    measured = [field for field in values if field.size]
    if not measured:
        return ColourRange(0.0, 1.0, diverging=False)
    low = min(float(np.percentile(field, _OUTERMOST_PERCENT)) for field in measured)
    high = max(float(np.percentile(field, 100.0 - _OUTERMOST_PERCENT)) for field in measured)
    diverging = min(-low, high) >= _DIVERGING_SHARE * (high - low) > 0.0
    if diverging:
        high = max(-low, high)
        low = -high
    ticks = MaxNLocator(nbins=6, steps=ROUND_STEPS).tick_values(low, high)
    return ColourRange(float(ticks[0]), float(ticks[-1]), diverging)


def draw_map(
    axes: Axes,
    grid: Grid,
    values: Field,
    valid: NDArray[np.bool_],
    colours: ColourRange,
    scale: ImageScale,
    under: Background | None = None,
) -> AxesImage:
    """Draw a field over the image, y down, blank where it is not valid.

    Args:
        axes: receives the map.
        grid: positions of the values in frame 0.
        values: (ny, nx) values.
        valid: (ny, nx) False where nothing was measured.
        colours: range of the colours.
        scale: unit of lengths.
        under: image of frame 0; None draws no image.
    """
    if under is not None:
        draw_image(axes, replace(under, grey=_averaged(under.grey, MAX_UNDER_PX)), scale)
    half, factor = grid.step_px / 2, scale.factor
    extent = (grid.x_px[0] - half, grid.x_px[-1] + half, grid.y_px[-1] + half, grid.y_px[0] - half)
    shown = axes.imshow(
        masked(values, valid),
        extent=tuple(factor * edge for edge in extent),
        cmap=colours.colours,
        vmin=colours.low,
        vmax=colours.high,
        alpha=1.0 if under is None else _OPACITY,
        interpolation="none",
    )
    left, right, lower, upper = visible_px(grid, under)
    axes.set(xlim=(factor * left, factor * right), ylim=(factor * lower, factor * upper))
    return shown


def visible_px(grid: Grid, under: Background | None) -> tuple[float, float, float, float]:
    """Left, right, lower and upper edge of a map in px: the points, and the image around them where there is one."""
    half = grid.step_px / 2
    left, right, upper, lower = (
        float(edge) for edge in (grid.x_px[0] - half, grid.x_px[-1] + half, grid.y_px[0] - half, grid.y_px[-1] + half)
    )
    if under is None:
        return left, right, lower, upper
    margin = MARGIN_FRACTION * (right - left)
    return (
        max(0.0, left - margin),
        min(float(under.width_px), right + margin),
        min(float(under.height_px), lower + margin),
        max(0.0, upper - margin),
    )


def masked(values: Field, valid: NDArray[np.bool_]) -> np.ma.MaskedArray:
    """A field for a panel, blank where it is not valid; a field of more than `MAX_PANEL_PX` points along an edge is sampled."""
    every = -(-max(values.shape) // MAX_PANEL_PX)
    return np.ma.masked_array(values[::every, ::every], ~valid[::every, ::every])


def draw_image(axes: Axes, under: Background, scale: ImageScale) -> None:
    """Draw the SEM image with its grey levels stretched over all but the outermost percent."""
    low, high = np.percentile(under.grey, (_OUTERMOST_PERCENT, 100.0 - _OUTERMOST_PERCENT))
    extent = (0.0, scale.factor * under.width_px, scale.factor * under.height_px, 0.0)
    axes.imshow(under.grey, extent=extent, cmap=_GREYS, vmin=low, vmax=max(high, low + 1.0), interpolation="none")


def draw_mask(axes: Axes, mask: NDArray[np.bool_], scale: ImageScale) -> None:
    """Hatch the part of frame 0 that is not used.

    Args:
        axes: shows the image of frame 0.
        mask: (height, width) True where the frame may be used.
        scale: unit of lengths.
    """
    height, width = mask.shape
    every = -(-max(mask.shape) // MAX_PANEL_PX)
    excluded = ~mask[::every, ::every]
    if min(excluded.shape) < 2 or not excluded.any():
        return
    x, y = (scale.factor * (np.arange(0, size, every) + 0.5) for size in (width, height))
    hatched = axes.contourf(x, y, excluded.astype(np.float32), levels=(0.5, 1.5), colors="none", hatches=("////",))
    hatched.set_edgecolor("white")
    axes.contour(x, y, excluded.astype(np.float32), levels=(0.5,), colors="white", linewidths=0.8)


def scale_bar(axes: Axes, scale: ImageScale) -> None:
    """Draw a bar of a round length in the lower left corner of a map with y down, with its length above it."""
    (first, last), (lower, upper) = axes.get_xlim(), axes.get_ylim()
    width, height = last - first, lower - upper
    length = round_length(BAR_FRACTION * width)
    start = first + 0.04 * width
    bar = Rectangle((start, lower - 0.065 * height), length, 0.035 * height, facecolor="white", edgecolor="black", linewidth=0.3, zorder=4)
    axes.add_patch(bar)
    place = (start + length / 2, lower - 0.075 * height)
    text = axes.annotate(f"{length:g} {scale.unit}", place, ha="center", va="bottom", fontsize=6.5, color="white")
    text.set_bbox({"facecolor": "black", "alpha": 0.75, "linewidth": 0, "pad": 1.0})


def round_length(most: float) -> float:
    """The largest of 1, 2, 5, 10, 20, 50 ... that is at most `most`."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step for step in (1, 2, 5) if step * power <= most * (1 + 1e-9)) * power)


def map_sheet(rows: int, columns: int, aspect: float, width_inch: float) -> tuple[Figure, list[list[Axes]]]:
    """A figure of equal panels with room for one colour bar at the right of each row.

    Args:
        rows: number of quantities.
        columns: number of maps of each.
        aspect: height over width of a map.
        width_inch: width of the figure.
    """
    panel = (width_inch - 1.4) / columns
    figure = Figure(figsize=(width_inch, rows * (panel * aspect + 0.12) + 0.7), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    return figure, [list(row) for row in panels]


def label_lengths(panels: Sequence[Sequence[Axes]], scale: ImageScale) -> None:
    """Label the axes at the lower and left edges of a sheet."""
    for axes in panels[-1]:
        axes.set_xlabel(f"x ({scale.unit})")
    for row in panels:
        row[0].set_ylabel(f"y ({scale.unit})")
