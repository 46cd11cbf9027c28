"""Table of `semlive plan` that shows the largest load that each fault can cause before the stop."""

from __future__ import annotations

from dataclasses import asdict

from rich.box import SIMPLE_HEAD
from rich.table import Table

from semlive.data.loading import ControlMode
from semlive.engine.supervision.stop_distance import StopDistance, exceeds
from semlive.service.planning.stop_distances import StopPlan


def stop_table(stops: StopPlan) -> Table:
    """Table with one row for each fault; faults that exceed the force limit are marked."""
    case = stops.case
    title = (
        f"largest load before the stop after a fault: ramp from {case.start_n:g} to {case.target_n:g} N at {case.rate_n_s:g} N/s, "
        f"force limit {case.limit_n:g} N"
    )
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("if", overflow="fold")
    table.add_column("stopped by")
    table.add_column("after at most", justify="right", no_wrap=True)
    table.add_column("beyond", overflow="fold")
    table.add_column("true load up to", justify="right", no_wrap=True)
    for row in stops.rows:
        exceeding = exceeds(row, case)
        table.add_row(
            row.fault,
            row.code.value,
            "" if row.seconds is None else f"{row.seconds:.1f} s",
            _beyond(row),
            "not bounded" if row.worst_n is None else f"{row.worst_n:.0f} N{' *' if exceeding else ''}",
            style="bold yellow" if exceeding or row.worst_n is None else None,
        )
    marked = "* more than 5 % beyond the force limit; " if stops.exceeding else ""
    cell = f"changes below {case.noticeable_n:.3g} N count as noise" if case.noticeable_n else "load cell without noise"
    control = "displacement control" if case.control is ControlMode.DISPLACEMENT else "load control"
    table.caption = (
        f"{marked}{control}, {cell} (--force-noise-n, --force-resolution-n), readings every {case.poll_s:g} s, one fault at a time"
    )
    return table


def stop_json(stops: StopPlan) -> dict[str, object]:
    """The table as JSON: the ramp, and a list of rows with `exceeds_limit`; unbounded values are null."""
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
