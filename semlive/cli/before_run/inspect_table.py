"""The table that `semlive inspect` prints."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.shared.terminal import cell
from semlive.data.scan import Provenance, ScanGeometry, Sourced, setting_text
from semlive.formats.images.inspection import Inspection

_QUANTITIES = {
    "dwell_time_s": ("dwell time, one pass", 1e6, "us"),
    "row_time_s": ("row time, passes and fly-back", 1e3, "ms"),
    "frame_time_s": ("frame time, one scan", 1.0, "s"),
    "integrations": ("scans integrated", 1.0, ""),
    "line_integrations": ("passes over each line", 1.0, ""),
    "pixel_size_m": ("pixel size", 1e9, "nm"),
    "detector": ("detector", 1.0, ""),
    "voltage_v": ("voltage", 1e-3, "kV"),
    "working_distance_m": ("working distance", 1e3, "mm"),
    "magnification": ("magnification", 1.0, "x"),
    "scan_rotation_deg": ("scan rotation", 1.0, "degrees"),
    "instrument": ("instrument", 1.0, ""),
    "scan_speed": ("scan speed", 1.0, ""),
}


def print_inspection(console: Console, path: Path, inspection: Inspection) -> None:
    """Print the table of one file: quantity, value and source of the value; below it problems and notes."""
    state = "complete" if inspection.complete else "not complete"
    table = Table(title=cell(f"{path}: {inspection.vendor}, {state}"), box=SIMPLE_HEAD, padding=0, title_justify="left")
    for name in ("quantity", "value", "from"):
        table.add_column(name, no_wrap=True)
    size = "unknown" if inspection.width_px is None else f"{inspection.width_px} x {inspection.height_px} px"
    table.add_row("image without databar", size, "file" if inspection.width_px else "unknown")
    if inspection.databar_rows is not None:
        table.add_row("databar below it", f"{inspection.databar_rows} rows", "derived")
    for name, value in inspection.values.items():
        label, scale, unit = _QUANTITIES[name]
        missing = value.source is Provenance.UNKNOWN
        table.add_row(label, _text(value, scale, unit), value.source.value, style="dim" if missing else None)
    for field in fields(ScanGeometry):
        setting = getattr(inspection.geometry, field.name)
        if setting is not None:
            table.add_row(*(cell(text) for text in setting_text(field.name, setting.value)), setting.source.value)
    for name, text in _arithmetic(inspection):
        table.add_row(name, text, "derived")
    table.add_row("time in the file", cell(str(inspection.acquired.value or "")), inspection.acquired.source.value)
    console.print(table)
    for problem in inspection.problems:
        console.print(f"  [bold]![/bold] {cell(problem)}", highlight=False)
    for note in inspection.notes:
        console.print(f"  - {cell(note)}", highlight=False)
    console.print()


def _text(value: Sourced[float] | Sourced[int] | Sourced[str] | Sourced[None], scale: float, unit: str) -> str:
    if value.value is None:
        return ""
    shown = cell(value.value) if isinstance(value.value, str) else f"{value.value * scale:.6g}"
    return f"{shown} {unit}".strip()


def _arithmetic(inspection: Inspection) -> list[tuple[str, str]]:
    """Quantities derived from the times: fly-back of a pass, rows scanned beyond the image, and total duration."""
    numbers = {name: value.value for name, value in inspection.values.items() if isinstance(value.value, int | float)}
    rows: list[tuple[str, str]] = []
    if {"dwell_time_s", "row_time_s"} <= numbers.keys() and inspection.width_px:
        back_s = numbers["row_time_s"] / numbers.get("line_integrations", 1) - inspection.width_px * numbers["dwell_time_s"]
        rows.append(("fly-back of a pass", f"{back_s * 1e6:.4g} us"))
    if {"frame_time_s", "row_time_s"} <= numbers.keys() and inspection.height_px:
        rows.append(("rows beyond the image", f"{numbers['frame_time_s'] / numbers['row_time_s'] - inspection.height_px:.2f} rows"))
    if "frame_time_s" in numbers:
        rows.append(("total duration", f"{numbers['frame_time_s'] * numbers.get('integrations', 1):.6g} s"))
    return rows
