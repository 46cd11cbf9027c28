"""A load frame's parts: whatever tells the load, the extension or a strain, and whatever can be told to move."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

from semlive.data.loading import DeviceFault, MotionState
from semlive.ports import ClockSource


class PartCommand(StrEnum):
    """What a part can be told.

    `RAMP` goes to a load by the device's own control. `JOG_TENSION` and `JOG_COMPRESSION` move the crosshead by no more than a given travel
    and end by themselves.
    `ARM` and `DISARM` are the device's own watchdog.
    """

    RAMP = "ramp"
    JOG_TENSION = "pull"
    JOG_COMPRESSION = "push"
    STOP = "stop"
    ARM = "arm"
    DISARM = "disarm"


WITHHELD = "watchdog withheld"
"""The way to stop a device with an armed watchdog that always works while the device does: it is not fed any more."""

MOTIONS = frozenset({PartCommand.RAMP, PartCommand.JOG_TENSION, PartCommand.JOG_COMPRESSION})


@dataclass(frozen=True, slots=True)
class PartReading:
    """What one part says in one turn; None is what it does not tell.

    Attributes:
        force_n: tension positive.
        extension_mm: of the crosshead, pulling positive.
        motion: by its own word.
        target_n: the load it is going to or holding.
        lag_s: how far a simulator is behind its clock.
        force_max_n: its own limit.
        gage_strain: of a strain gage, tension positive.
        trouble: why it is in fault.
        raw: registers as read.
        reading_counter: its counter of readings, and at how many that begins anew.
    """

    force_n: float | None = None
    extension_mm: float | None = None
    motion: MotionState | None = None
    target_n: float | None = None
    lag_s: float | None = None
    force_max_n: float | None = None
    gage_strain: float | None = None
    raw: tuple[int, ...] = ()
    trouble: DeviceFault | None = None
    reading_counter: tuple[int, int] | None = None


class Part(Protocol):
    """One device, opened and greeted. Not thread-safe. Every method but `close` may raise LinkError."""

    @property
    def where(self) -> str:
        """Who it is and how it is reached."""
        ...

    @property
    def simulated(self) -> bool:
        """Whether it says that it is a simulator."""
        ...

    @property
    def has_watchdog(self) -> bool:
        """Whether it says that it stops when nobody speaks to it any more, and is armed to."""
        ...

    @property
    def capabilities(self) -> frozenset[PartCommand]:
        """What it can be told."""
        ...

    def read(self) -> PartReading:
        """A fresh reading; tells the device that we are there."""
        ...

    def identify(self) -> PartReading:
        """A fresh reading that writes nothing."""
        ...

    def command(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Give an order; returns when the device has taken it.

        Args:
            what: the order.
            values: ``force_n``, ``rate_n_s`` of a ramp; ``travel_mm`` (at most, positive), ``speed_mm_s`` of a motion.
        """
        ...

    def blind_stop(self) -> None:
        """Say stop without waiting for an answer, on a link that failed; never raises."""
        ...

    def close(self) -> None:
        """Close the link; never raises."""
        ...


class OrderBook(Protocol):
    """What a machine can be ordered, and how exactly."""

    @property
    def can(self) -> frozenset[PartCommand]:
        """What it can be told."""
        ...

    def order_problem(self, what: PartCommand, values: Mapping[str, float]) -> str | None:
        """Why an order cannot be given as it is meant, or None; sends nothing and never raises."""
        ...

    def step_of(self, value: str) -> float:
        """Smallest step of ``travel_mm`` or ``speed_mm_s`` in orders to pull, in that unit; 0 where the number format sets none."""
        ...


@dataclass(frozen=True, slots=True)
class Way:
    """A further way to stop a device, tried when it does not obey its stop order.

    Attributes:
        says: what it does, for a person.
        act: does it; raises LinkError if the device did not take it.
    """

    says: str
    act: Callable[[], None]


@dataclass(frozen=True, slots=True)
class Stops:
    """How a part is stopped besides the plain order.

    Attributes:
        blind: writes a stop without waiting for an answer, as `semlive.ports.BlindStop.stop_blind`; never raises.
        ways: further ways, in the order in which they are tried.
    """

    blind: Callable[[], bool]
    ways: tuple[Way, ...] = ()


@runtime_checkable
class DevicePart(Part, Protocol):
    """A part behind a link that can carry orders, or a person who takes them. Methods may raise LinkError unless stated."""

    @property
    def manual(self) -> bool:
        """Whether a person moves it."""
        ...

    @property
    def book(self) -> OrderBook:
        """What it can be ordered, and how exactly."""
        ...

    @property
    def stops(self) -> Stops:
        """How it is stopped besides the plain order."""
        ...

    def order_changed(self) -> str | None:
        """How the device's own orders differ from what was given last, as a sentence, or None; asked for before each `read`."""
        ...

    def resolution(self) -> tuple[float, float]:
        """Smallest change of force, N, and of extension, mm, in the last reading; 0 where the number format sets none."""
        ...


@runtime_checkable
class OrderHolder(Protocol):
    """A part whose device holds its last order in values that can be read, also after the process that gave the order has ended."""

    @property
    def cleared(self) -> bool:
        """Whether every value of the difference that `DevicePart.order_changed` found last is 0, as after a restart."""
        ...

    def recall(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Compare the device from now on with an order that an earlier process gave; sends nothing and never raises."""
        ...


class PartFactory(Protocol):
    """Opens a part."""

    def __call__(self, settings: Mapping[str, object], clock: ClockSource) -> Part:
        """Raises BadConfig, LinkRefused or LinkError."""
        ...
