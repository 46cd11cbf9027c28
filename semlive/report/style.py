"""Common style of all figures: width of a journal page, colours that colour-blind readers can distinguish, fonts that stay text."""

from __future__ import annotations

import io
import re
from contextlib import AbstractContextManager
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from semlive.report.svg_images import compact_svg

PAGE_INCH = 7.0
"""178 mm, the width of a journal page with two columns."""
X_COLOUR, Y_COLOUR, SHEAR_COLOUR, INK, SOFT = "#0072b2", "#d55e00", "#009e73", "#0f172a", "#64748b"
"""Blue, vermilion and green of Okabe and Ito (2008), https://jfly.uni-koeln.de/color/."""
GRID: dict[str, Any] = {"color": "#94a3b8", "alpha": 0.25, "linewidth": 0.6}
_PUBLICATION: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "figure.titlesize": 8,
    "legend.fontsize": 7.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "lines.markersize": 4,
    "font.family": "sans-serif",
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "semlive",
}
_SUPERSCRIPTS = str.maketrans("0123456789+-\N{MINUS SIGN}", "⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻⁻")
PNG_DPI = 300
SCREEN_DPI = 130
_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": "semlive"},
    "pdf": {"CreationDate": None, "Creator": "semlive"},
    "png": {"Software": "semlive"},
}
"""No time of writing, so that equal figures are equal files."""


def publication_style() -> AbstractContextManager[None]:
    """Return the context in which figures are drawn and written; font sizes are fixed when a text is made."""
    return rc_context(_PUBLICATION)


def framed(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure of the given size in inches with one pair of axes in the common style."""
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    plain_axes(axes)
    return figure, axes


class _TickLabels(ScalarFormatter):
    """Labels of ticks as plain text; to parse them as mathematical text took a third of the time of a figure."""

    def get_offset(self) -> str:
        """Return a common factor as a power of ten."""
        return re.sub(r"1e(\S\d*)", lambda found: "×10" + found[1].translate(_SUPERSCRIPTS), super().get_offset())


def plain_axes(*many: Axes) -> None:
    """Draw a light grid and omit the upper and right edges."""
    for axes in many:
        axes.grid(**GRID)
        axes.spines[["top", "right"]].set_visible(False)


def _label_ticks(figure: Figure) -> None:
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        if type(axis.get_major_formatter()) is ScalarFormatter:
            axis.set_major_formatter(_TickLabels())


def png(figure: Figure) -> bytes:
    """The figure as PNG bytes for a screen."""
    stream = io.BytesIO()
    _label_ticks(figure)
    figure.set_dpi(SCREEN_DPI)
    FigureCanvasAgg(figure).print_png(stream, metadata=_METADATA["png"], pil_kwargs={"compress_level": 3})
    return stream.getvalue()


def figure_bytes(figure: Figure, kind: str) -> bytes:
    """The figure as the content of a file: ``png`` with 300 dpi, ``svg`` or ``pdf``.

    `Figure.savefig` draws a figure twice, first without output; the canvases draw it once.
    """
    stream = io.BytesIO()
    _label_ticks(figure)
    figure.set_dpi(PNG_DPI)
    match kind:
        case "svg":
            FigureCanvasSVG(figure).print_svg(stream, metadata=_METADATA[kind])
            stream = io.BytesIO(compact_svg(stream.getvalue().decode("utf-8")).encode("utf-8"))
        case "pdf":
            FigureCanvasPdf(figure).print_pdf(stream, metadata=_METADATA[kind])
        case _:
            FigureCanvasAgg(figure).print_png(stream, metadata=_METADATA["png"])
    # Further files keep this layout, which is a third of the time of a file.
    figure.set_layout_engine("none")
    return stream.getvalue()


def fix_layout(figure: Figure) -> None:
    """Compute the layout once, so that each further file of the figure need not repeat it."""
    _label_ticks(figure)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
