"""All figures of a report in order, with titles and captions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from semlive.data.loading import LoadSeries
from semlive.data.results import RunResult
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadInput
from semlive.report import figures, paper_figures

COLUMN_INCH = 7.0
"""178 mm, the width of a journal page with two columns."""
_PUBLICATION: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "font.family": "DejaVu Sans",
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}
_DPI = 300


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A figure with its title and caption.

    Attributes:
        key: key for file names.
        title: heading.
        caption: caption, with the corresponding figure of Sutton et al. (2007).
        figure: the figure.
    """

    key: str
    title: str
    caption: str
    figure: Figure


_TEXTS = {
    "load": ("Load", "Load as sampled; accepted frames are shaded."),
    "fig01-drift-in-frames": ("Drift within frames", "As Fig. 1."),
    "fig05-drift": ("Drift", "As Fig. 5, with the band of two standard uncertainties in place of the input."),
    "fig06-pair": ("Residual in a pair", "As Fig. 6: no motion between the two frames."),
    "fig07-left": (
        "Uncorrected distortion",
        "As Fig. 7: mean residual of all unloaded frames after correction, mean strain subtracted.",
    ),
    "fig10-drift-field": ("Drift over a field", "As Fig. 10."),
    "fig11-distortion": ("Distortion", "As Fig. 11; the best affine map is not observable and is removed."),
    "fig12-unloaded": ("Strain without load", "As Fig. 12: should be zero within the bars."),
    "fig13-loaded": ("Strain under load", "As Fig. 13."),
    "strain-maps": ("Strain maps", "The last frame."),
    "stress-strain": ("Stress and strain", "Means over the field."),
    "fig14-constants": ("Elastic constants", "As Fig. 14; bars are two standard uncertainties."),
    "gage": ("Strain gage", "Comparison of DIC with the gage."),
    "fig15-path": ("Translation path", "As Fig. 15."),
    "fig16-false-strain": ("False strain", "As Fig. 16: without correction, for 5 px."),
}
"""Title and description of each section by its key, in the order of the report."""


def sections(result: RunResult, series: LoadSeries | None, settings: AnalysisSettings) -> Iterator[Section]:
    """Figures for which the run has data.

    Args:
        result: every frame corrected with the newest estimate.
        series: load as sampled, or None without a load frame.
        settings: settings of the analysis.
    """
    area_mm2, axis, window = settings.specimen.area_mm2, settings.specimen.loading_axis, settings.estimate.window_points
    loaded = series is not None and series.time_ns.size > 0
    drawn = {
        "load": figures.load_over_time(series, result) if series and loaded else None,
        "fig01-drift-in-frames": paper_figures.drift_within_frames(result),
        "fig05-drift": figures.drift_over_time(result),
        "fig06-pair": paper_figures.pair_residual(result),
        "fig07-left": paper_figures.distortion_residual(result),
        "fig10-drift-field": paper_figures.drift_over_field(result),
        "fig11-distortion": figures.distortion_fields(result),
        "fig12-unloaded": paper_figures.unloaded_strain(result),
        "fig13-loaded": paper_figures.loaded_strain(result, area_mm2),
        "strain-maps": _last_maps(result),
        "stress-strain": figures.stress_strain(result, area_mm2, axis) if area_mm2 else None,
        "fig14-constants": paper_figures.constants(result),
        "gage": figures.gage_comparison(result.gage) if result.gage else None,
        "fig15-path": paper_figures.translation_path(result),
        "fig16-false-strain": paper_figures.false_strain_figure(result, window),
    }
    for key, (title, description) in _TEXTS.items():
        figure = drawn[key]
        if figure is not None:
            yield Section(key, title, description, figure)


def _last_maps(result: RunResult) -> Figure | None:
    if not result.frames:
        return None
    last = result.frames[-1]
    return figures.strain_maps(last, f"frame {last.summary.frame}, virtual strain gauge {last.summary.vsg_px:.0f} px")


def write_figures(
    folder: Path,
    result: RunResult,
    series: LoadSeries | None,
    settings: AnalysisSettings,
    progress: Callable[[int, int], object] = lambda *_: None,
) -> list[Path]:
    """Write every figure as PNG (300 dpi) and PDF with the width of a journal page and embedded text.

    Raises:
        BadInput: the folder cannot be written.
    """
    written: list[Path] = []
    with rc_context(_PUBLICATION):
        drawn = tuple(sections(result, series, settings))
        for number, section in enumerate(drawn, start=1):
            written += write_section(folder, section)
            progress(number, len(drawn))
    return written


def write_section(folder: Path, section: Section) -> list[Path]:
    """Write one figure as PNG and PDF.

    Raises:
        BadInput: the folder cannot be written.
    """
    width, height = section.figure.get_size_inches()
    section.figure.set_size_inches(COLUMN_INCH, COLUMN_INCH * height / width)
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for kind in ("png", "pdf"):
            path = folder / f"{section.key}.{kind}"
            section.figure.savefig(path, dpi=_DPI, facecolor="white")
            written.append(path)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written ({error.strerror or error}); give a writable folder") from error
    return written
