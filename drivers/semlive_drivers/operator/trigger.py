"""The operator as trigger: semlive requests one scan, and the exported file is the answer."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict

from semlive.ports import ClockSource
from semlive_drivers.operator.console import TERMINAL, Console
from semlive_drivers.settings import checked


class OperatorTriggerSettings(BaseModel):
    """Settings of the operator as trigger."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    ask: str = "scan one frame now and save it into the export folder"
    """Text of the request."""


class OperatorTrigger:
    """The Trigger port over a person: it shows a request; the file of the frame arrives in the watched folder."""

    def __init__(self, settings: OperatorTriggerSettings, console: Console) -> None:
        self._settings, self._console = settings, console

    def scan_once(self) -> None:
        """Show the request for one frame."""
        self._console.show(self._settings.ask)

    def close(self) -> None:
        """Do nothing: nothing is open."""


def open_trigger(settings: Mapping[str, object], clock: ClockSource, *, console: Console = TERMINAL) -> OperatorTrigger:
    """The operator as trigger.

    Raises:
        BadConfig: for settings that are not valid.
    """
    del clock  # a trigger has no samples with times
    return OperatorTrigger(checked(OperatorTriggerSettings, settings, "operator trigger"), console)
