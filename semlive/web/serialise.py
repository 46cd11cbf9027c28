"""Serialisation of the page state as JSON: completely, or its changes."""

from __future__ import annotations

import json
from dataclasses import asdict, is_dataclass

from semlive.web.downsampled_series import DownsampledSeries, LoadRow
from semlive.web.page_state import Drift, LogRows, PageState, Schedule
from semlive.web.run_progress import RunProgress

PARTS = (
    *("run", "schedule", "protocol", "reading", "drift", "quality", "strength", "alarms", "desk", "frames", "maps"),
    *("scan", "progress"),
)


def full_state(view: PageState) -> dict[str, object]:
    """Return all parts."""
    return {**{name: _part(view, name) for name in PARTS}, "load": {"from": 0, **_load(view.load, 0)}, "lines": _lines(view.lines, 0)}


def state_diff(before: PageState, now: PageState) -> dict[str, object]:
    """Return the parts that differ; of the load series and the log, the new rows."""
    parts = {name: _part(now, name) for name in PARTS if getattr(before, name) is not getattr(now, name)}
    if before.load is not now.load:
        sent_rows = len(before.load.rows) if before.load.width_s == now.load.width_s else 0
        parts["load"] = {"from": sent_rows, **_load(now.load, sent_rows)}
    if before.lines is not now.lines:
        parts["lines"] = _lines(now.lines, before.lines.count)
    return parts


def to_json_line(content: dict[str, object]) -> str:
    """Return one line of JSON.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    return json.dumps(content, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _part(view: PageState, name: str) -> object:
    part = getattr(view, name)
    if isinstance(part, Drift):
        return {**_shallow(part), "frames": [{"frame": drift.frame, "rows": drift.rows} for drift in part.frames]}
    if isinstance(part, Schedule):
        done, measures = part.done, part.measures
        ahead = part.planned[len([step for step in done if not step.warm_up]) :]
        more = (asdict(ahead[0]) | {"warm_up": True, "load_n": None, "phase": "calibration"},) if measures and ahead else ()
        return {"done": len(done), "steps": [*map(asdict, done), *more, *map(asdict, ahead)]}
    return part.shown() if isinstance(part, RunProgress) else _plain(part)


def _plain(part: object) -> object:
    if isinstance(part, tuple):
        return [_plain(item) for item in part]
    return asdict(part) if is_dataclass(part) and not isinstance(part, type) else part


def _shallow(part: Drift) -> dict[str, object]:
    return {name: getattr(part, name) for name in part.__dataclass_fields__}


def _lines(lines: LogRows, sent_rows: int) -> dict[str, object]:
    """Return the rows that were not sent, and the number of rows before them."""
    rows = lines.rows[-(lines.count - sent_rows) :]
    return {"from": lines.count - len(rows), "rows": [asdict(row) for row in rows]}


def _load(trace: DownsampledSeries, sent_rows: int) -> dict[str, object]:
    rows = [*trace.rows[sent_rows:], *([trace.current_bin] if trace.current_bin else [])]
    return {"rows": [_row(row) for row in rows]}


def _row(row: LoadRow) -> tuple[float, ...]:
    return round(row.time_s, 3), round(row.low_n, 3), round(row.high_n, 3), round(row.extension_mm, 6), round(row.target_n, 3)
