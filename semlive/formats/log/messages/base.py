"""Bases of all messages of the log."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

Point = tuple[float, float]


class Message(BaseModel):
    """Base of all messages: frozen, no unknown fields, no NaN."""

    # By default pydantic caches every short string that it reads, up to 16,384 of them; file names are never repeated.
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=False, cache_strings="keys")


class BootStamped(Message):
    """Base of messages with an instant of the monotonic clock.

    Attributes:
        boot_id: identity of the boot that the clock belongs to; empty if unknown.
    """

    boot_id: str = ""


class MonotonicStamped(BootStamped):
    """Base of messages of the control process: they hold the monotonic clock of the computer in addition to experiment time.

    Attributes:
        mono_ns: monotonic clock when the message was created, ns.
    """

    mono_ns: int = 0
