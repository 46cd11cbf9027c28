"""The table that `semlive inspect` prints."""

from __future__ import annotations

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.terminal import cell
from semlive.data.scan import Provenance, Sourced
from semlive.formats.images.inspection import Inspection

_WORDS = {
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


def print_inspection(console: Console, path: Path, one: Inspection) -> None:
    """A table of one file: what, value, where it comes from; below it what is wrong or unusual."""
    state = "complete" if one.complete else "not complete"
    table = Table(title=cell(f"{path}: {one.vendor}, {state}"), box=SIMPLE_HEAD, padding=0, title_justify="left")
    for name in ("quantity", "value", "from"):
        table.add_column(name, no_wrap=True)
    size = "unknown" if one.width_px is None else f"{one.width_px} x {one.height_px} px"
    table.add_row("image without databar", size, "file" if one.width_px else "unknown")
    if one.databar_rows is not None:
        table.add_row("databar below it", f"{one.databar_rows} rows", "derived")
    for name, value in one.values.items():
        word, scale, unit = _WORDS[name]
        missing = value.source is Provenance.UNKNOWN
        table.add_row(word, _text(value, scale, unit), value.source.value, style="dim" if missing else None)
    for name, text in _arithmetic(one):
        table.add_row(name, text, "derived")
    table.add_row("time in the file", cell(str(one.acquired.value or "")), one.acquired.source.value)
    console.print(table)
    for problem in one.problems:
        console.print(f"  [bold]![/bold] {cell(problem)}", highlight=False)
    for note in one.notes:
        console.print(f"  - {cell(note)}", highlight=False)
    console.print()


def _text(value: Sourced[float] | Sourced[int] | Sourced[str] | Sourced[None], scale: float, unit: str) -> str:
    if value.value is None:
        return ""
    shown = cell(value.value) if isinstance(value.value, str) else f"{value.value * scale:.6g}"
    return f"{shown} {unit}".strip()


def _arithmetic(one: Inspection) -> list[tuple[str, str]]:
    """What the times imply: fly-back of a pass, rows that a scan lasts beyond the image, and the whole duration."""
    numbers = {name: value.value for name, value in one.values.items() if isinstance(value.value, int | float)}
    rows: list[tuple[str, str]] = []
    if {"dwell_time_s", "row_time_s"} <= numbers.keys() and one.width_px:
        back_s = numbers["row_time_s"] / numbers.get("line_integrations", 1) - one.width_px * numbers["dwell_time_s"]
        rows.append(("fly-back of a pass", f"{back_s * 1e6:.4g} us"))
    if {"frame_time_s", "row_time_s"} <= numbers.keys() and one.height_px:
        rows.append(("beyond the image's rows", f"{numbers['frame_time_s'] / numbers['row_time_s'] - one.height_px:.2f} rows"))
    if "frame_time_s" in numbers:
        rows.append(("whole duration", f"{numbers['frame_time_s'] * numbers.get('integrations', 1):.6g} s"))
    return rows
