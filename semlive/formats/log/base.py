"""What all messages of the log have in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Message(BaseModel):
    """Base of all messages: frozen, no unknown fields, no NaN."""

    # pydantic would keep every short string that it reads, up to 16,384 of them; names of files never come again.
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=False, cache_strings="keys")


class BootStamped(Message):
    """Base of what holds an instant of the monotonic clock.

    Attributes:
        boot_id: identity of the boot that the clock belongs to; empty if unknown.
    """

    boot_id: str = ""


class MonotonicStamped(BootStamped):
    """Base of what control tells as it happens: the computer's own clock beside experiment time.

    Attributes:
        mono_ns: monotonic clock when it was told.
    """

    mono_ns: int = 0
