"""The two functions that the module of a trigger offers: open the trigger, and report the settings of its microscope."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from semlive.data.checks import Finding, Verdict
from semlive.errors import LinkError, LinkRefused
from semlive.ports import ClockSource
from semlive_drivers.microscope.frame_files import require_folder
from semlive_drivers.microscope.trigger import MicroscopeSettings, MicroscopeTrigger
from semlive_drivers.settings import checked

UNTRIED = "this trigger is written from public documentation and not yet tried at a microscope: compare the values with its screen"
S = TypeVar("S", bound=MicroscopeSettings)


@dataclass(frozen=True, slots=True)
class MicroscopeDriver(Generic[S]):
    """Driver of a microscope.

    Attributes:
        name: name in errors.
        settings: class of its settings.
        trigger: makes the trigger without a connection; raises LinkRefused if another process uses the device.
    """

    name: str
    settings: type[S]
    trigger: Callable[[S, ClockSource], MicroscopeTrigger]

    def open_trigger(self, settings: Mapping[str, object], clock: ClockSource) -> MicroscopeTrigger:
        """Check that the microscope answers and could scan now.

        Raises:
            BadConfig: for settings that are not valid.
            LinkRefused: the microscope does not answer or cannot scan, another process uses it, or the client of its vendor is missing.
        """
        return _opened(self.trigger(checked(self.settings, settings, self.name), clock))

    def check_device(self, settings: Mapping[str, object], clock: ClockSource) -> Sequence[Finding]:
        """What the microscope reports; changes nothing.

        Raises:
            BadConfig: for settings that are not valid.
        """
        config = checked(self.settings, settings, self.name)
        return _findings(lambda: self.trigger(config, clock), config)


def _findings(open_trigger: Callable[[], MicroscopeTrigger], settings: MicroscopeSettings) -> Sequence[Finding]:
    """What a microscope reports, for `semlive doctor` and `semlive plan`; changes nothing.

    Args:
        open_trigger: makes the trigger without a connection; raises LinkRefused if another process uses the device.
        settings: its settings.
    """
    try:
        require_folder(settings.folder)
        trigger = open_trigger()
    except LinkError as error:
        return (Finding("sem.trigger", str(error), Verdict.FAILED, "correct sem.trigger.settings, or stop the other run"),)
    try:
        name, reading = trigger.report()
    except LinkError as error:
        return (Finding("sem.trigger", str(error), Verdict.FAILED, "start the remote interface, check address and beam"),)
    finally:
        trigger.close()
    found = [Finding("sem.trigger", f"{name} reports {reading.text()}", Verdict.UNKNOWN, UNTRIED)]
    if reading.shortest_frame_s >= settings.frame_timeout_s:
        observation = f"a frame takes at least {reading.shortest_frame_s:.0f} s, frame_timeout_s is {settings.frame_timeout_s:g} s"
        advice = "set sem.trigger.settings.frame_timeout_s to twice the frame time"
        found.append(Finding("sem.trigger", observation, Verdict.FAILED, advice))
    return tuple(found)


def _opened(trigger: MicroscopeTrigger) -> MicroscopeTrigger:
    """Return a trigger whose microscope answers and can write frames.

    Raises:
        LinkRefused: it does not answer, cannot scan, or the folder is missing.
    """
    try:
        trigger.report()
    except LinkRefused:
        trigger.close()
        raise
    except LinkError as error:
        trigger.close()
        raise LinkRefused(str(error)) from error
    return trigger
