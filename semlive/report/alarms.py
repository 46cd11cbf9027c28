"""Alarms of a run as blocks of a report."""

from __future__ import annotations

from datetime import UTC, datetime

from semlive.report.document.blocks import Block, Paragraph, Table
from semlive.service.log.alarms import Alarm, Alarms

_HEADINGS = ("time (UTC)", "level", "code", "where", "what", "action", "acknowledged")


def alarm_blocks(alarms: Alarms | None) -> tuple[Block, ...]:
    """Every alarm of a run, in order.

    Args:
        alarms: alarms of the log; None if the log was not read for alarms.
    """
    if alarms is None:
        return (Paragraph("Unknown: the log was not read for alarms."),)
    if not alarms.listed:
        return (Paragraph("None."),)
    omitted = f" The {alarms.forgotten} oldest acknowledged or repeated ones are not listed." if alarms.forgotten else ""
    summary = f"{len(alarms.listed) + alarms.forgotten} alarms, {len(alarms.open)} of them not acknowledged.{omitted}"
    return Paragraph(summary), Table("Alarms in the order of time.", _HEADINGS, tuple(_cells(alarm) for alarm in alarms.listed), text=True)


def _cells(alarm: Alarm) -> tuple[str, ...]:
    acknowledged = "no" if alarm.acknowledged_ns is None else f"{_utc(alarm.acknowledged_ns)} {alarm.acknowledged_by}".strip()
    return _utc(alarm.time_ns), alarm.level.value, alarm.code, alarm.where, alarm.text, alarm.action, acknowledged


def _utc(time_ns: int) -> str:
    # Milliseconds by integer arithmetic: a float of ns since 1970 has a resolution of a quarter of a microsecond, and rounds.
    seconds, rest_ns = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{rest_ns // 1_000_000:03d}"
