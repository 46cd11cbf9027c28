"""The table of `semlive plan` that shows how far the specimen can go before each stop."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from semlive.data.loading import ControlMode
from semlive.engine.supervision.stop_distance import StopDistance, exceeds
from semlive.service.planning.stop_distances import StopPlan


def stop_table(stops: StopPlan) -> Table:
    """Text: one row for each fault, those beyond the force limit marked."""
    case = stops.case
    title = (
        f"how far the load can go before it is stopped: ramp from {case.start_n:g} to {case.target_n:g} N at {case.rate_n_s:g} N/s, "
        f"force limit {case.limit_n:g} N"
    )
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("if", overflow="fold")
    table.add_column("it is stopped as")
    table.add_column("after at most", justify="right", no_wrap=True)
    table.add_column("beyond", overflow="fold")
    table.add_column("true load up to", justify="right", no_wrap=True)
    for row in stops.rows:
        far = exceeds(row, case)
        table.add_row(
            row.fault,
            row.code.value,
            "" if row.seconds is None else f"{row.seconds:.1f} s",
            _beyond(row),
            "not bounded" if row.worst_n is None else f"{row.worst_n:.0f} N{' *' if far else ''}",
            style="bold yellow" if far or row.worst_n is None else None,
        )
    marked = "* more than 5 % beyond the force limit; " if stops.exceeding else ""
    cell = f"changes of {case.noticeable_n:.3g} N taken for noise" if case.noticeable_n else "a load cell without noise"
    control = "displacement control" if case.control is ControlMode.DISPLACEMENT else "load control"
    table.caption = (
        f"{marked}{control}, {cell} (--force-noise-n, --force-resolution-n), readings every {case.poll_s:g} s, one fault at a time"
    )
    return table


def stop_json(stops: StopPlan) -> dict[str, Any]:
    """The same as JSON: the ramp, and a list of rows with `exceeds_limit`; values that nothing bounds are null."""
    case = stops.case
    return {
        "start_n": case.start_n,
        "target_n": case.target_n,
        "ramp_rate_n_s": case.rate_n_s,
        "force_limit_n": case.limit_n,
        "control": case.control.value,
        "noticeable_n": case.noticeable_n,
        "rows": [{**asdict(row), "exceeds_limit": exceeds(row, case)} for row in stops.rows],
    }


def _beyond(row: StopDistance) -> str:
    if row.beyond_n is None:
        return row.remark
    travel = "" if row.travel_mm is None else f" ({row.travel_mm:.4f} mm)"
    more = f"; {row.remark}" if row.remark else ""
    return f"{row.beyond_n:.3g} N{travel} beyond {row.reference}{more}"
