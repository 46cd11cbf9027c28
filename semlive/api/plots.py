"""The standard figures of an open log, as matplotlib figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

from semlive.errors import BadInput
from semlive.report import figures
from semlive.report.export.fields import RunMetadata

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from semlive.data.results import FrameResult

FigureKind = Literal["load", "drift", "distortion", "stress_strain", "fields"]


def run_figure(kind: str, metadata: RunMetadata) -> Figure:
    """Return a figure of the run.

    Raises:
        BadInput: there is no such figure, or the log has no data for it.
    """
    result, settings = metadata.result, metadata.settings
    drawn: Figure | None = None
    match kind:
        case "drift":
            drawn = figures.drift_over_time(result)
        case "distortion":
            drawn = figures.distortion_fields(result)
        case "load" if metadata.load is not None and metadata.load.time_ns.size:
            drawn = figures.load_over_time(metadata.load, result)
        case "stress_strain" if settings["specimen.area_mm2"] is not None:
            drawn = figures.stress_strain(result, settings["specimen.area_mm2"], settings["specimen.loading_axis"])
    if drawn is None:
        reason = (
            "the log has no data for it"
            if kind in get_args(FigureKind)
            else f"no such figure; the figures are {', '.join(get_args(FigureKind))}"
        )
        raise BadInput(f"plot({kind!r}): {reason}.")
    return drawn


def field_figure(frame: FrameResult) -> Figure:
    """Return displacement and strain of one frame as maps."""
    return figures.field_maps(frame, f"frame {frame.summary.frame}, virtual strain gauge {frame.summary.vsg_px:.0f} px")
