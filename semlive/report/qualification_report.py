"""Report of a qualification: two pages for the wall, and the figures over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import yaml
from matplotlib.figure import Figure as Drawing

from semlive.qualify.further import proposals
from semlive.qualify.history import FigureHistory, all_dated, comparable, histories
from semlive.qualify.limits import REFERENCE_SHIFT_PX
from semlive.qualify.values import Figure, Qualification
from semlive.report.document.blocks import Bullets, Document, FigureBlock, KeyFigures, Listing, Paragraph, Section, Table
from semlive.report.qualification_texts import MICRO, change_text, figure_text, limiting_text, setup_text
from semlive.report.style import INK, PAGE_INCH, SOFT, X_COLOUR, Y_COLOUR, framed, plain_axes

PANELS_PER_ROW = 3
RECOMMENDED = ("protocol", "dic", "estimate")
"""Sections of a configuration that a qualification recommends."""


def qualification_document(qualification: Qualification, configuration: str) -> Document:
    """The report of one qualification.

    Args:
        qualification: the result.
        configuration: recommended configuration.
    """
    conditions, protocol = qualification.conditions, qualification.protocol
    dwell = f" ({MICRO * conditions.dwell_s:.3g} us)" if conditions.timed else ""
    blocks = [KeyFigures(_key_figures(qualification)), Paragraph(limiting_text(qualification))]
    if qualification.resolution:
        title = "Strain resolution against gauge length"
        caption = (
            f"Noise of one gauge with its 95 % interval, and false strain for a shift of {REFERENCE_SHIFT_PX:g} px and the drift of one "
            "frame, without and with correction."
        )
        blocks.append(FigureBlock("resolution", title, caption, resolution_figure(qualification)))
    blocks.append(_limit_table(qualification))
    steps = [
        f"Wait {protocol.warm_up_s / 60.0:.0f} minutes after the specimen is inserted and the beam is on."
        if protocol.warm_up_s
        else "No waiting time is needed, or the frames do not determine one.",
        f"Scan with {protocol.dwell_factor:g} times the dwell time of these frames{dwell}.",
        f"Take {len(protocol.shifts_px)} pairs at shifts of up to {max(max(abs(v) for v in shift) for shift in protocol.shifts_px):g} px.",
        f"Correlate with subsets of {protocol.subset_px} px, {protocol.step_px} px apart, and gauges of {protocol.window_points} points.",
        f"The calibration takes about {protocol.minutes:.0f} minutes.",
    ]
    measured = [Table("Measured figures", ("figure", "value", "95 % interval", "unit"), _rows(qualification.figures))]
    more = [Bullets(tuple(f"{item.name}: {item.reason}; {item.remedy}." for item in qualification.undetermined))]
    sections = [
        Section("Result", tuple(blocks)),
        Section(
            "Recommended protocol", (Bullets(tuple(steps)), Listing("In the configuration of --protocol", _recommended(configuration)))
        ),
        Section("Figures", tuple(measured)),
    ]
    if qualification.setups:
        titles = ("figure", "value", "95 % interval", "unit")
        tables = tuple(Table(setup_text(setup), titles, _rows(setup.figures)) for setup in qualification.setups)
        sections.append(Section("Other settings of the scan", tables))
    if further := proposals(qualification):
        texts = tuple(f"{item.step.change[0].upper()}{item.step.change[1:]}, and take pairs: {item.reason}." for item in further)
        sections.append(Section("Further steps", (Bullets(texts),)))
    if qualification.undetermined:
        sections.append(Section("Not determined by these frames", tuple(more)))
    day = f", {conditions.day}" if conditions.dated else ""
    size = f"{conditions.width_px} x {conditions.height_px} px" + (f" of {conditions.pixel_nm:.4g} nm" if conditions.pixel_nm else "")
    return Document(f"Qualification of {conditions.source}", f"{conditions.pairs} pairs of frames of {size}{day}", tuple(sections))


def _recommended(configuration: str) -> str:
    """The sections of a configuration that the recommendation determines; those of the instrument would fill half a page."""
    sections = yaml.safe_load(configuration) or {}
    return yaml.safe_dump(
        {key: sections[key] for key in RECOMMENDED if key in sections}, sort_keys=False, default_flow_style=None, width=120
    )


def _rows(figures: Sequence[Figure]) -> tuple[tuple[str, ...], ...]:
    return tuple((figure.title, *figure_text(figure), figure.unit) for figure in figures)


def _key_figures(qualification: Qualification) -> tuple[tuple[str, str], ...]:
    named = {figure.name: figure for figure in qualification.figures}
    entries = []
    if qualification.resolution:
        best = min(qualification.resolution, key=lambda item: abs(item.gauge_px - 83))
        entries.append((f"strain noise, gauge of {best.gauge_px} px", f"{MICRO * best.noise:.0f} microstrain"))
    for name, label in (("drift_rate", "drift rate"), ("distortion", "largest distortion"), ("waiting_time", "waiting time")):
        if name in named:
            entries.append((label, f"{figure_text(named[name])[0]} {named[name].unit}"))
    if qualification.limiting:
        entries.append(("limit", qualification.limiting.replace("_", " ")))
    return tuple(entries)


def _limit_table(qualification: Qualification) -> Table:
    rows = tuple(
        (limit.name.replace("_", " "), f"{MICRO * limit.strain:.0f}", f"{MICRO * limit.strain_corrected:.0f}", limit.remedy)
        for limit in qualification.limits
    )
    return Table("Sources of strain error, microstrain", ("source", "not corrected", "corrected", "remedy"), rows, text=True)


def resolution_figure(qualification: Qualification) -> Drawing:
    """Strain noise and false strain against gauge length, logarithmic."""
    figure, axes = framed(PAGE_INCH, 2.8)
    shown = qualification.resolution
    length = np.array([item.gauge_px for item in shown], dtype=np.float64)
    noise, low, high = (MICRO * np.array([getattr(item, name) for item in shown]) for name in ("noise", "noise_low", "noise_high"))
    axes.errorbar(length, noise, yerr=(noise - low, high - noise), color=X_COLOUR, marker="o", capsize=2, label="noise, measured")
    for name, label, style in (
        ("systematic", "false strain, not corrected", "-"),
        ("systematic_corrected", "false strain, corrected", "--"),
    ):
        values = MICRO * np.array([getattr(item, name) for item in shown])
        if (values > 0.0).all():
            axes.plot(length, values, color=Y_COLOUR, linestyle=style, label=label)
    axes.set(xscale="log", yscale="log", xlabel="gauge length (px)", ylabel="strain (microstrain)")
    axes.legend(frameon=False)
    return figure


def history_document(qualifications: Sequence[Qualification]) -> Document:
    """The figures of one microscope over time, those that became worse first."""
    found = [history for history in histories(qualifications) if len(history.figures) > 1]
    worse = [history for history in found if history.worse]
    title = f"{len(qualifications)} qualifications of one microscope"
    verdict = (
        "Worse beyond both intervals: " + "; ".join(change_text(history) for history in worse) + "."
        if worse
        else "No figure became worse beyond the intervals of the two newest qualifications."
    )
    blocks = [Paragraph(verdict)]
    if not comparable(qualifications):
        blocks.append(Paragraph("Frame size, pixel size or dwell time differ between them, so changes may be those of the settings."))
    drawn = [history for history in found if any(figure.low < figure.high for figure in history.figures)]
    if not drawn:
        return Document(title, "", (Section("Changes", tuple(blocks)),))
    shown = history_figure(drawn, dated=all_dated(qualifications))
    block = FigureBlock("history", "Figures over time", "Bars are 95 % intervals; orange figures became worse.", shown)
    return Document(title, "", (Section("Changes", (*blocks, block)),))


def history_figure(drawn: Sequence[FigureHistory], *, dated: bool) -> Drawing:
    """One panel for each figure, over days since the first qualification; over its number if a day is unknown."""
    rows = -(-len(drawn) // PANELS_PER_ROW)
    figure = Drawing(figsize=(PAGE_INCH, 1.5 * rows + 0.3), layout="constrained")
    panels = figure.subplots(rows, PANELS_PER_ROW, squeeze=False).ravel()
    zero_ns = min(history.time_ns[0] for history in drawn)
    for axes, history in zip(panels, drawn, strict=False):
        place = [(time_ns - zero_ns) / 86_400e9 if dated else number for number, time_ns in enumerate(history.time_ns, 1)]
        values = np.array([(item.value, item.value - item.low, item.high - item.value) for item in history.figures]).T
        axes.errorbar(
            place, values[0], yerr=np.maximum(values[1:], 0.0), color=Y_COLOUR if history.worse else X_COLOUR, marker="o", capsize=2
        )
        unit = f" ({history.figures[-1].unit})" if history.figures[-1].unit else ""
        axes.set_title(f"{history.name.replace('_', ' ')}{unit}", color=INK)
        axes.set_xlabel("days" if dated else "number", color=SOFT)
        plain_axes(axes)
    for axes in panels[len(drawn) :]:
        axes.set_visible(False)
    return figure
