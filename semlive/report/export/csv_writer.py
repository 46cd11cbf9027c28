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

    def write_metadata(self, story: RunMetadata) -> None:
        """Write the series."""
        write_table(self._out / "series.csv", frame_series(story), {"phase": phases(story)})
        write_table(self._out / "drift.csv", drift_series(story.result))
        write_table(self._out / "distortion.csv", distortion_fields(story.result))
        if story.load is not None:
            write_table(self._out / "load.csv", load_series(story.load))
        write_json_files(self._out, story)

    def close(self, complete: bool) -> None:
        """Nothing is open."""


def write_json_files(folder: Path, story: RunMetadata) -> None:
    """Result, settings and configuration as JSON files."""
    for name, value in (("result", story.result_json), ("settings", story.settings), ("configuration", story.configuration)):
        (folder / f"{name}.json").write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def write_table(path: Path, arrays: Mapping[str, Array], words: Mapping[str, list[str]] | None = None) -> None:
    """Arrays of one length (or fields of one shape) as columns, words behind; NaN is an empty cell."""
    columns = [_column(array) for array in arrays.values()]
    names = [_named(name) for name in arrays]
    for name, texts in (words or {}).items():
        names.append(name)
        columns.append(texts)
    lines = [",".join(names), *map(",".join, zip(*columns, strict=True)), ""]
    path.write_text("\n".join(lines), encoding="ascii", newline="\n")


def _named(name: str) -> str:
    """The column's name with its unit."""
    unit = UNITS.get(name, "1")
    return name if unit == "1" or name.endswith("_" + unit.lower()) else f"{name}_{unit.lower()}"


def _column(array: Array) -> list[str]:
    flat = array.ravel()
    if flat.dtype.kind in "bui":
        return [str(int(one)) for one in flat.tolist()]
    return ["" if np.isnan(one) else repr(one) for one in flat.tolist()]
