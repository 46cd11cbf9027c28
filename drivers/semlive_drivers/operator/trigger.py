"""A hand at the microscope: the operator is asked for one scan, and the exported file is the answer."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict

from semlive.ports import ClockSource
from semlive_drivers.modbus.settings import checked
from semlive_drivers.operator.console import TERMINAL, Console


class OperatorTriggerSettings(BaseModel):
    """Settings of the operator as trigger."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    ask: str = "scan one frame now and save it into the export folder"
    """What the operator is told."""


class OperatorTrigger:
    """The Trigger port over a person: asking is all; the frame counts when its file arrives."""

    def __init__(self, settings: OperatorTriggerSettings, console: Console) -> None:
        self._settings, self._console = settings, console

    def scan_once(self) -> None:
        """Ask for one frame."""
        self._console.show(self._settings.ask)

    def close(self) -> None:
        """Nothing is open."""


def open_trigger(settings: Mapping[str, object], clock: ClockSource, *, console: Console = TERMINAL) -> OperatorTrigger:
    """The operator as trigger.

    Raises:
        BadConfig: for settings that are not understood.
    """
    del clock  # a trigger has no samples to stamp
    return OperatorTrigger(checked(OperatorTriggerSettings, settings, "operator trigger"), console)
