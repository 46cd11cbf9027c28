"""`/log`: a line of text of the service, in the JSON that the log panel of Foxglove reads."""

from __future__ import annotations

from pydantic import model_serializer, model_validator

from semlive.formats.log.messages.base import Message, MonotonicStamped


class FoxgloveTime(Message):
    """An instant in the form of the JSON schemas of Foxglove."""

    sec: int
    nsec: int


class FoxgloveLog(MonotonicStamped):
    """The JSON of `/log`: the schema `foxglove.Log`, which the log panel shows, and keys of semlive.

    Attributes:
        timestamp: experiment time.
        level: 0 unknown, 1 debug, 2 info, 3 warning, 4 error, 5 fatal.
        message: the text.
        name: source of the text.
        file: empty.
        line: 0.
        time_ns: experiment time, UTC ns.
        text: the text again, under the key of older logs.
    """

    timestamp: FoxgloveTime
    level: int
    message: str
    name: str
    file: str
    line: int
    time_ns: int
    text: str


_LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")
_OF_FOXGLOVE = ("timestamp", "message", "name", "file", "line")


class LogLineMessage(MonotonicStamped):
    """`/log`: one line of text of the service; its JSON is a `FoxgloveLog`."""

    time_ns: int
    level: str
    text: str

    @model_serializer
    def _as_foxglove(self) -> FoxgloveLog:
        sec, nsec = divmod(self.time_ns, 10**9)
        return FoxgloveLog(
            timestamp=FoxgloveTime(sec=sec, nsec=nsec),
            level=_LEVELS.index(self.level) if self.level in _LEVELS else 0,
            message=self.text,
            name="semlive",
            file="",
            line=0,
            time_ns=self.time_ns,
            text=self.text,
            mono_ns=self.mono_ns,
            boot_id=self.boot_id,
        )

    @model_validator(mode="before")
    @classmethod
    def _from_foxglove(cls, values: object) -> object:
        if not isinstance(values, dict) or not isinstance(values.get("level"), int):
            return values
        level = values["level"]
        ours = {name: value for name, value in values.items() if name not in _OF_FOXGLOVE}
        return {**ours, "level": _LEVELS[level] if 0 <= level < len(_LEVELS) else "unknown"}
