"""Parts of a load frame: the devices that measure load, extension or strain, and the devices that move."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

from semlive.data.loading import DeviceFault, MotionState


class PartCommand(StrEnum):
    """Orders that a part can take.

    `RAMP` brings the load to a target by the device's own control. `JOG_TENSION` and `JOG_COMPRESSION` move the crosshead by at most a
    given travel and end without a further order. `ARM` and `DISARM` switch the watchdog of the device.
    """

    RAMP = "ramp"
    JOG_TENSION = "pull"
    JOG_COMPRESSION = "push"
    STOP = "stop"
    ARM = "arm"
    DISARM = "disarm"


WITHHELD = "watchdog withheld"
"""Description of the last stop method of a device with an armed watchdog: semlive sends no heartbeat any more."""
FOREIGN_ORDER = "another program or a person commands it, or it was restarted"
"""Why a device holds another order than semlive gave."""
SATURATED = "the sensor is saturated or not connected; check sensor, cable and amplifier"
"""Why a reading is at the end of its range."""

MOTIONS = frozenset({PartCommand.RAMP, PartCommand.JOG_TENSION, PartCommand.JOG_COMPRESSION})


@dataclass(frozen=True, slots=True)
class PartReading:
    """Values of one part in one turn; None for a value that the part does not measure.

    Attributes:
        force_n: load, N, tension positive.
        extension_mm: extension of the crosshead, mm, tension positive.
        motion: motion state that the device reports.
        target_n: load that the device goes to or holds, N.
        lag_s: delay of a simulator behind its clock, s.
        force_max_n: force limit of the device, N.
        gage_strain: strain of a strain gage, tension positive.
        trouble: why the device is in fault.
        raw: registers as read.
        reading_counter: counter of readings of the device, and the count at which it restarts from 0.
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
    """One device, opened and identified. Not thread-safe. Every method but `close` may raise LinkError."""

    @property
    def where(self) -> str:
        """Name and address of the device."""
        ...

    @property
    def simulated(self) -> bool:
        """Whether the device reports that it is a simulator."""
        ...

    @property
    def has_watchdog(self) -> bool:
        """Whether the device stops when it receives no more requests, and this watchdog is armed."""
        ...

    @property
    def capabilities(self) -> frozenset[PartCommand]:
        """Orders that the part can take."""
        ...

    def read(self) -> PartReading:
        """Feed the watchdog of the device, and take a new reading."""
        ...

    def identify(self) -> PartReading:
        """Take a new reading without writing anything."""
        ...

    def command(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Give an order; returns after the device took it.

        Args:
            order: the order.
            values: ``force_n`` and ``rate_n_s`` of a ramp; ``travel_mm`` (largest travel, positive) and ``speed_mm_s`` of a jog.
        """
        ...

    def blind_stop(self) -> None:
        """Write a stop without waiting for an answer, on a link that failed; never raises."""
        ...

    def close(self) -> None:
        """Close the link; never raises."""
        ...


class OrderBook(Protocol):
    """Orders that a device can take, and how exactly."""

    @property
    def can(self) -> frozenset[PartCommand]:
        """Orders that the device can take."""
        ...

    def order_problem(self, order: PartCommand, values: Mapping[str, float]) -> str | None:
        """Why an order cannot be given exactly, or None; sends nothing and never raises."""
        ...

    def step_of(self, value: str) -> float:
        """Smallest step of ``travel_mm`` or ``speed_mm_s`` in orders in tension, in that unit; 0 where the number format sets none."""
        ...


@dataclass(frozen=True, slots=True)
class StopMethod:
    """A further method to stop a device, used when the device does not obey its stop order.

    Attributes:
        description: what the method does, for the operator.
        act: performs it; raises LinkError if the device did not take it.
    """

    description: str
    act: Callable[[], None]


@dataclass(frozen=True, slots=True)
class Stops:
    """Methods to stop a part in addition to its stop order.

    Attributes:
        blind: writes a stop without waiting for an answer, as `semlive.ports.BlindStop.stop_blind`; never raises.
        methods: further methods, in the order in which they are used.
    """

    blind: Callable[[], bool]
    methods: tuple[StopMethod, ...] = ()


@runtime_checkable
class DevicePart(Part, Protocol):
    """A part that can take orders: a device behind a link, or a person. Methods may raise LinkError unless stated."""

    @property
    def manual(self) -> bool:
        """Whether a person moves the load frame."""
        ...

    @property
    def book(self) -> OrderBook:
        """Orders that the part can take, and how exactly."""
        ...

    @property
    def stops(self) -> Stops:
        """Methods to stop the part in addition to its stop order."""
        ...

    def order_changed(self) -> str | None:
        """How the orders in the device differ from the last order, as a message, or None; called before each `read`."""
        ...

    def resolution(self) -> tuple[float, float]:
        """Smallest change of force, N, and of extension, mm, in the last reading; 0 where the number format sets none."""
        ...


@runtime_checkable
class OrderHolder(Protocol):
    """A part whose device stores its last order in readable values, also after the process that gave the order has ended."""

    @property
    def cleared(self) -> bool:
        """Whether every value of the last difference found by `DevicePart.order_changed` is 0, as after a restart."""
        ...

    def recall(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Compare the device from now on with an order of an earlier process; sends nothing and never raises."""
        ...
