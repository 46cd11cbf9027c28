"""Section on material and instrument: prose, the SEM image with the measured points, and every setting with its origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from semlive.data.frame import FrameInfo, FrameOrigin
from semlive.data.scan import setting_text
from semlive.data.settings import SpecimenSettings
from semlive.inputs.mask_file import read_mask
from semlive.report.document.blocks import Block, FigureBlock, Paragraph, Section, Table
from semlive.report.maps import draw_image, draw_mask, scale_bar
from semlive.report.run_data import RunData
from semlive.report.sections.wording import NOT_RECORDED, joined, seconds, source, utc_date, utc_time
from semlive.report.style import PAGE_INCH, X_COLOUR, Y_COLOUR

_MOST_POINTS = 16
"""Largest number of points along an edge of the grid in the figure."""
_NAMED_SETTINGS = ("map", "device", "program", "kind")
Row = tuple[str, str, str]


def instrument_section(data: RunData) -> Section:
    """Material and instrument.

    Args:
        data: of the run.
    """
    last = data.result.decisions[-1].second
    blocks: list[Block] = [Paragraph(specimen_text(data.settings.specimen)), Paragraph(microscope_text(data.first, last))]
    image = _image_block(data)
    blocks += [image] if image else [Paragraph("The log holds no readable SEM image of frame 0, so maps are drawn without it.")]
    rows = (*instrument_rows(data.first), *_device_rows(data.facts.config or {}, data.facts.host))
    blocks += [
        Table("Settings of microscope and devices, as recorded for frame 0.", ("quantity", "value", "source"), rows, text=True),
        Paragraph(_constancy([info for decision in data.result.decisions for info in (decision.first, decision.second)])),
    ]
    return Section("Material and instrument", tuple(blocks))


def specimen_text(specimen: SpecimenSettings) -> str:
    """Name, cross-section and direction of the load; values that are not recorded are named."""
    name = f"The specimen is {specimen.name}." if specimen.name else f"The material of the specimen is {NOT_RECORDED}."
    area = (
        f"Its cross-section is {NOT_RECORDED}, so there is no stress and there are no elastic constants."
        if specimen.area_mm2 is None
        else f"Its cross-section of {specimen.area_mm2:g} mm² is a configured value; its uncertainty is {NOT_RECORDED}."
    )
    return f"{name} {area} The load acts along the image axis {specimen.loading_axis}."


def microscope_text(first: FrameInfo, last: FrameInfo | None = None) -> str:
    """Date, detector, voltage, pixel size and scan times in prose.

    Args:
        first: frame 0.
        last: the last frame; None if only frame 0 is known.
    """
    if first.origin is FrameOrigin.IMPORTED:
        return "The log was made from disparity maps of another program. It holds no images; settings of the microscope are those below."
    start_ns = first.start_time_ns.value
    began, ended = utc_date(start_ns), "" if last is None else utc_date(last.end_time_ns)
    when = f"at {utc_time(start_ns)} UTC on {began}"
    if last is not None:
        day = "" if ended == began else f" on {began}"
        when = f"from {utc_time(start_ns)}{day} to {utc_time(last.end_time_ns)} UTC on {ended}"
    column = first.column
    settings = [
        f"acceleration voltage {NOT_RECORDED if column.voltage_v is None else f'{column.voltage_v.value / 1e3:g} kV'}",
        f"detector {NOT_RECORDED if column.detector is None else column.detector.value}",
        f"magnification {NOT_RECORDED if column.magnification is None else f'{column.magnification.value:g}'}",
        f"working distance {NOT_RECORDED if column.working_distance_m is None else f'{1e3 * column.working_distance_m.value:.2f} mm'}",
    ]
    timing, size_m = first.timing, first.pixel_size_m.value
    field = (
        f"The pixel size is {NOT_RECORDED}."
        if size_m <= 0
        else f"A pixel is {1e6 * size_m:.4g} µm wide, the field {1e6 * size_m * first.width_px:.4g} µm x "
        f"{1e6 * size_m * first.height_px:.4g} µm."
    )
    fly_back_s = timing.row_time_s.value - timing.line_integrations.value * first.width_px * timing.dwell_time_s.value
    row = f"a row takes {seconds(timing.row_time_s.value)}"
    row += f", of which {seconds(fly_back_s)} are fly-back" if fly_back_s > 0 else ""
    return (
        f"{'Frame 0 was' if last is None else 'Frames were'} recorded {when}: {joined(settings)}. "
        f"A frame has {first.width_px} x {first.height_px} px. {field} The beam stays {seconds(timing.dwell_time_s.value)} on a pixel, "
        f"{row}, and a scan takes {seconds(timing.frame_time_s.value)}; scans integrated in a frame: {timing.integrations.value}."
    )


def instrument_rows(info: FrameInfo) -> tuple[Row, ...]:
    """Quantity, value and source of every setting of a frame; missing ones are named as not recorded."""
    column, timing = info.column, info.timing

    def row(name: str, value: Any, text: str) -> Row:
        return name, text if value is not None else NOT_RECORDED, source(value) if value is not None else "-"

    def number(value: Any, factor: float, unit: str) -> str:
        return "" if value is None else f"{factor * value.value:.5g} {unit}".strip()

    size = info.pixel_size_m if info.pixel_size_m.value > 0 else None
    fly_back_s = timing.row_time_s.value - timing.line_integrations.value * info.width_px * timing.dwell_time_s.value
    rows = [
        ("format of the image files", info.vendor, "image file"),
        ("model of the microscope", NOT_RECORDED, "the image files in the log may name it"),
        row("detector", column.detector, "" if column.detector is None else column.detector.value),
        row("acceleration voltage", column.voltage_v, number(column.voltage_v, 1e-3, "kV")),
        row("magnification, by the convention of the maker", column.magnification, number(column.magnification, 1.0, "")),
        row("working distance", column.working_distance_m, number(column.working_distance_m, 1e3, "mm")),
        row("scan rotation", column.scan_rotation_deg, number(column.scan_rotation_deg, 1.0, "degrees")),
        row("pixel size", size, number(size, 1e6, "µm")),
        row("distance of the rows", info.geometry.pixel_height_m, number(info.geometry.pixel_height_m, 1e6, "µm")),
        ("image", f"{info.width_px} x {info.height_px} px, {info.databar_rows} rows of the databar removed", "image file"),
        row("dwell time", timing.dwell_time_s, seconds(timing.dwell_time_s.value)),
        row("row time", timing.row_time_s, seconds(timing.row_time_s.value)),
        ("fly-back time", seconds(fly_back_s) if fly_back_s > 0 else NOT_RECORDED, "row time less the dwell times"),
        row("time of a scan", timing.frame_time_s, seconds(timing.frame_time_s.value)),
        row("scans integrated in a frame", timing.integrations, str(timing.integrations.value)),
        row("passes over a row", timing.line_integrations, str(timing.line_integrations.value)),
        row("start of the scan", info.start_time_ns, f"standard uncertainty {seconds(info.start_sigma_s)}"),
    ]
    others = {name: value for name, value in info.geometry.values().items() if name != "pixel_height_m"}
    rows += [(*setting_text(name, value), "image file") for name, value in others.items()]
    return tuple(rows)


def _device_rows(config: Mapping[str, Any], host: str) -> tuple[Row, ...]:
    rows = [_device(config, key, name) for key, name in (("load_frame", "load frame"), ("stage", "stage or beam shift"))]
    return (*rows, ("computer", host or NOT_RECORDED, "log"))


def _device(config: Mapping[str, Any], key: str, name: str) -> Row:
    section = config.get(key)
    if not isinstance(section, Mapping):
        return name, NOT_RECORDED, "-"
    settings = section.get("settings") or {}
    named = ", ".join(f"{part} {settings[part]}" for part in _NAMED_SETTINGS if isinstance(settings.get(part), str | int))
    return name, f"driver {section.get('driver', NOT_RECORDED)}" + (f" ({named})" if named else ""), "configuration"


def _constancy(infos: Sequence[FrameInfo]) -> str:
    names = ("detector", "voltage_v", "working_distance_m", "magnification", "scan_rotation_deg")
    changed = [name for name in names if len({getattr(info.column, name) and getattr(info.column, name).value for info in infos}) > 1]
    if infos[0].origin is FrameOrigin.IMPORTED:
        return "Whether the settings changed in the run is not recorded."
    if not changed:
        return (
            f"Recorded detector, voltage, working distance, magnification and scan rotation are equal in all {len(infos)} frames of pairs."
        )
    words = joined([name.removesuffix("_v").removesuffix("_m").removesuffix("_deg").replace("_", " ") for name in changed])
    return f"Not constant in the {len(infos)} frames of pairs: {words}."


def _image_block(data: RunData) -> FigureBlock | None:
    under = data.background
    if under is None:
        return None
    grid, scale = data.result.estimate.distortion.grid, data.scale
    window = data.settings.estimate.window_points
    gauge = grid.vsg_px(window)
    figure = Figure(figsize=(0.8 * PAGE_INCH, 0.8 * PAGE_INCH * under.height_px / under.width_px + 0.35), layout="constrained")
    axes, factor = figure.subplots(), scale.factor
    draw_image(axes, under, scale)
    every = max(1, -(-max(grid.nx, grid.ny) // _MOST_POINTS))
    x0, y0 = factor * grid.x_px[0], factor * grid.y_px[0]
    x1, y1 = factor * grid.x_px[-1], factor * grid.y_px[-1]
    axes.vlines(factor * grid.x_px[::every], y0, y1, color="#f0e442", linewidth=0.5)
    axes.hlines(factor * grid.y_px[::every], x0, x1, color="#f0e442", linewidth=0.5)
    axes.add_patch(_square(x0, y0, x1 - x0, y1 - y0, "#f0e442"))
    centre_x, centre_y = factor * float(np.mean(grid.x_px)), factor * float(np.mean(grid.y_px))
    for edge, colour in ((grid.subset_px, X_COLOUR), (gauge, Y_COLOUR)):
        if edge:
            axes.add_patch(_square(centre_x - factor * edge / 2, centre_y - factor * edge / 2, factor * edge, factor * edge, colour))
    mask = data.settings.dic.mask
    if mask is not None:
        draw_mask(axes, read_mask(mask), scale)
    scale_bar(axes, scale)
    axes.set(xlabel=f"x ({scale.unit})", ylabel=f"y ({scale.unit})")
    subset = f"blue square: subset of {grid.subset_px} px; " if grid.subset_px else ""
    hatched = "" if mask is None else "Hatched: mask, whose subsets are not measured. "
    caption = (
        f"SEM image of frame 0, the reference of all displacements ({data.first.name}), without its databar. Yellow frame: the "
        f"{grid.nx} x {grid.ny} measured points, {grid.step_px} px apart; a line is drawn through one in {every}. In the "
        f"middle, to scale, "
        f"{subset}vermilion square: virtual strain gauge of {gauge} px. {hatched}Grey levels are stretched. The load acts along "
        f"{data.settings.specimen.loading_axis}."
    )
    return FigureBlock("sem-image", "Reference image with the measured points", caption, figure)


def _square(x: float, y: float, width: float, height: float, colour: str) -> Rectangle:
    return Rectangle((x, y), width, height, fill=False, edgecolor=colour, linewidth=1.4)
