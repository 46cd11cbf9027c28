"""CSV: one file for each frame, and the series; units are in the names of the columns."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from semlive.data.results import FrameResult
from semlive.report.export.fields import (
    UNITS,
    Array,
    RunMetadata,
    distortion_fields,
    drift_series,
    frame_fields,
    frame_series,
    load_series,
    phases,
)


class CsvWriter:
    """A folder of tables.

    ``frame_<n>.csv``, ``series.csv``, ``drift.csv``, ``distortion.csv``, ``load.csv``; ``result.json``,
    ``settings.json``, ``configuration.json``.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        out.mkdir(parents=True, exist_ok=True)

    def write_frame(self, frame: FrameResult) -> None:
        """Write one frame, a point in each line."""
        write_table(self._out / f"frame_{frame.summary.frame:05d}.csv", frame_fields(frame))

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Write the series."""
        write_table(self._out / "series.csv", frame_series(metadata), {"phase": phases(metadata)})
        write_table(self._out / "drift.csv", drift_series(metadata.result))
        write_table(self._out / "distortion.csv", distortion_fields(metadata.result))
        if metadata.load is not None:
            write_table(self._out / "load.csv", load_series(metadata.load))
        write_json_files(self._out, metadata)

    def close(self, complete: bool) -> None:
        """Do nothing: no file is open."""


def write_json_files(folder: Path, metadata: RunMetadata) -> None:
    """Result, settings and configuration as JSON files."""
    for name, value in (("result", metadata.result_json), ("settings", metadata.settings), ("configuration", metadata.configuration)):
        (folder / f"{name}.json").write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def write_table(path: Path, arrays: Mapping[str, Array], texts: Mapping[str, list[str]] | None = None) -> None:
    """Write arrays of one length (or fields of one shape) as columns, followed by text columns; NaN is an empty cell."""
    columns = [_column(array) for array in arrays.values()]
    names = [_named(name) for name in arrays]
    for name, column in (texts or {}).items():
        names.append(name)
        columns.append(column)
    lines = [",".join(names), *map(",".join, zip(*columns, strict=True)), ""]
    path.write_text("\n".join(lines), encoding="ascii", newline="\n")


def _named(name: str) -> str:
    """Name of the column with its unit."""
    unit = UNITS.get(name, "1")
    return name if unit == "1" or name.endswith("_" + unit.lower()) else f"{name}_{unit.lower()}"


def _column(array: Array) -> list[str]:
    flat = array.ravel()
    if flat.dtype.kind in "bui":
        return [str(int(number)) for number in flat.tolist()]
    return ["" if np.isnan(number) else repr(number) for number in flat.tolist()]
