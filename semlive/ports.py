"""What semlive asks of the world outside: protocols that drivers and the shell fulfil.

Device calls block and are made from one thread only, the link thread that owns the device. A driver is a callable
``factory(settings, clock) -> LoadFrame | Stage | Trigger``, found by the entry point groups ``semlive.load_frames``,
``semlive.stages`` and ``semlive.triggers``; `settings` is the driver's part of the configuration, `clock` gives
experiment time. A factory raises BadConfig for settings it does not understand and LinkRefused if nobody answers.
Drivers that ask a person do so at a desk; desks are objects, found by the entry point group ``semlive.desks``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

from semlive.data.checks import Finding, FrameCheck
from semlive.data.loading import DeviceIdentity, LoadSample, StageKind, StageSample
from semlive.data.scan_report import ScanReport


class PromptEvent(StrEnum):
    """Event of the dialogue with the operator."""

    MESSAGE = "told"
    PROMPT = "asked"
    RESPONSE = "answered"
    WITHDRAWN = "taken_back"


class ResponseType(StrEnum):
    """Form of the response to a prompt."""

    CONFIRMATION = "confirmation"
    LOAD_N = "load_n"


@dataclass(frozen=True, slots=True)
class OperatorPrompt:
    """One event of the dialogue with the operator.

    Attributes:
        kind: message, prompt, response or withdrawal.
        text: content, one line.
        question: number of the prompt; None for messages.
        response_type: form of the response.
    """

    kind: PromptEvent
    text: str
    question: int | None = None
    response_type: ResponseType = ResponseType.CONFIRMATION


@runtime_checkable
class ClockSource(Protocol):
    """Experiment time now."""

    def now_ns(self) -> int:
        """Experiment time, UTC ns; never goes back."""
        ...

    def mono_ns(self) -> int:
        """Monotonic wall clock, ns."""
        ...


@runtime_checkable
class LoadFrame(Protocol):
    """A machine that pulls the specimen. Every method may raise LinkError."""

    @property
    def identity(self) -> DeviceIdentity:
        """Who answers, as read when the link was opened."""
        ...

    def read(self) -> LoadSample:
        """One fresh reading."""
        ...

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Start going to a load at a rate; returns when the device has taken the command (read back)."""
        ...

    def stop(self) -> None:
        """Stop motion and hold position; safe at any time, any number of times."""
        ...

    def close(self) -> None:
        """Close the link; never raises."""
        ...


@runtime_checkable
class BlindStop(Protocol):
    """A device whose stop can be written without waiting for an answer. Every load frame that moves should offer it."""

    def stop_blind(self) -> bool:
        """Write a stop on the existing connection and, where there is one to open, on a fresh connection; wait for no answer.

        May be called after any method raised LinkError, and again and again until the link is opened again; never raises, takes at most
        a few tenths of a second.

        Returns:
            Whether anything was written.
        """
        ...


@runtime_checkable
class StopMethods(Protocol):
    """A load frame that can be stopped in more than one way, tried in turn when it does not obey `stop`."""

    @property
    def stop_methods(self) -> tuple[str, ...]:
        """Description of each further method: ``enable off``, ``speed 0``; the plain stop is not included."""
        ...

    def stop_by(self, method: int) -> None:
        """Stop by the method of this index; raises LinkError."""
        ...


@runtime_checkable
class OrderCheck(Protocol):
    """A load frame that knows whether it can be ordered to do exactly what is meant."""

    def order_problem(self, force_n: float, rate_n_s: float) -> str | None:
        """Why a ramp cannot be ordered as meant (a value that rounds to 0, is clipped or too coarse), or None; sends nothing."""
        ...


@runtime_checkable
class OrderRecall(Protocol):
    """A load frame that can compare what its device holds with an order of an earlier process."""

    def recall_order(self, force_n: float, rate_n_s: float) -> None:
        """Report in `LoadSample.order_changed` from now on if the device does not hold this ramp any more; sends nothing, never raises."""
        ...


@runtime_checkable
class ChecksFiles(Protocol):
    """The module of a driver's factory, if the driver reads files of other programs and can check them before a run."""

    def check_files(self, settings: Mapping[str, object], clock: ClockSource) -> Sequence[Finding]:
        """Read each file as a run would; raises BadConfig for settings that are not valid."""
        ...


@runtime_checkable
class ChecksDevice(Protocol):
    """The module of a trigger's factory, if the trigger can report the settings of its microscope before a run."""

    def check_device(self, settings: Mapping[str, object], clock: ClockSource) -> Sequence[Finding]:
        """Connect, read the settings of the scan and disconnect; changes nothing; raises BadConfig for settings that are not valid."""
        ...


@runtime_checkable
class Stage(Protocol):
    """A device that translates the specimen or the beam. Every method may raise LinkError."""

    @property
    def identity(self) -> DeviceIdentity:
        """Who answers, as read when the link was opened."""
        ...

    @property
    def kind(self) -> StageKind:
        """What it moves."""
        ...

    def read(self) -> StageSample:
        """One fresh reading."""
        ...

    def move_to(self, x_um: float, y_um: float) -> None:
        """Start going to a position; returns when the device has taken the command (read back)."""
        ...

    def stop(self) -> None:
        """Stop motion; safe at any time, any number of times."""
        ...

    def close(self) -> None:
        """Close the link; never raises."""
        ...


@runtime_checkable
class Trigger(Protocol):
    """A device that makes the SEM scan one frame."""

    def scan_once(self) -> ScanReport | None:
        """Request one frame; returns when the request was accepted.

        Returns:
            The settings of the scan before and after it, from a trigger that waits for its end and reads them; else None.

        Raises:
            LinkError: the request was not accepted, or the frame is refused.
        """
        ...

    def close(self) -> None:
        """Close the link; never raises."""
        ...


@runtime_checkable
class OperatorInterface(Protocol):
    """Messages and questions of drivers to the operator; answers may come from other sources too."""

    def subscribe(self, receive: Callable[[OperatorPrompt], object]) -> None:
        """Call `receive` with every later prompt, in the thread that issues it; replaces the previous subscriber."""
        ...

    def add_answer_source(self, receive: Callable[[str], bool]) -> None:
        """Pass every later input line to `receive` first; a line for which it returns True answers no question."""
        ...

    def answer(self, question: int, line: str) -> bool:
        """Answer a question; return False if it is not open. An invalid answer is reported to the operator; the question stays open."""
        ...


LoadFrameFactory = Callable[[Mapping[str, object], ClockSource], LoadFrame]
StageFactory = Callable[[Mapping[str, object], ClockSource], Stage]
TriggerFactory = Callable[[Mapping[str, object], ClockSource], Trigger]
FrameChecker = Callable[[str, Mapping[str, object], ClockSource], FrameCheck]
"""Looks at the device that a description (by name or path) describes and never writes to it; group ``semlive.frame_checks``."""
