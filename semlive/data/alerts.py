"""Events of a run that persons who are not at the instrument can be alerted of."""

from __future__ import annotations

from enum import StrEnum


class AlertEvent(StrEnum):
    """Kind of event; a value of the configuration key `alerts.events`."""

    FAULT = "fault"
    QUESTION = "question"
    WARM_UP = "warm_up"
    END = "end"
