"""The report's section on alarms."""

from __future__ import annotations

import html
from datetime import UTC, datetime

from semlive.service.log.alarms import Alarm, Alarms

_HEADINGS = ("time (UTC)", "level", "code", "where", "what", "action", "acknowledged")


def alarms_html(alarms: Alarms | None) -> str:
    """Every alarm of a run, in order.

    Args:
        alarms: alarms of the log; None if the log was not read for alarms.
    """
    if alarms is None:
        return "<p>Unknown: the log was not read for alarms.</p>"
    if not alarms.listed:
        return "<p>None.</p>"
    omitted = f" The {alarms.forgotten} oldest acknowledged or repeated ones are not listed." if alarms.forgotten else ""
    summary = f"<p>{len(alarms.listed) + alarms.forgotten} alarms, {len(alarms.open)} of them not acknowledged.{omitted}</p>"
    head = "".join(f"<th>{heading}</th>" for heading in _HEADINGS)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in _cells(alarm)) + "</tr>" for alarm in alarms.listed)
    return f'{summary}<div class="scroll"><table class="text"><tr>{head}</tr>{body}</table></div>'


def _cells(alarm: Alarm) -> tuple[str, ...]:
    acknowledged = "no" if alarm.acknowledged_ns is None else f"{_utc(alarm.acknowledged_ns)} {alarm.acknowledged_by}".strip()
    return _utc(alarm.time_ns), alarm.level.value, alarm.code, alarm.where, alarm.text, alarm.action, acknowledged


def _utc(time_ns: int) -> str:
    # Milliseconds by integer arithmetic: a float of ns since 1970 has a resolution of a quarter of a microsecond, and rounds.
    seconds, rest_ns = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{rest_ns // 1_000_000:03d}"
