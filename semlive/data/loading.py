"""What the devices say: samples of load frame and stage, and the load during a frame."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class MotionState(StrEnum):
    """Whether a device is moving, by its own word."""

    STOPPED = "stopped"
    MOVING = "moving"
    FAULT = "fault"


class DeviceFault(StrEnum):
    """Why a device says that it is in fault."""

    OVERLOAD = "overload"
    WATCHDOG = "watchdog"
    LIMIT_SWITCH = "limit switch"
    EMERGENCY_STOP = "emergency stop"

    @property
    def is_emergency(self) -> bool:
        """Somebody or something stopped the machine with its own means, past every program."""
        return self in (DeviceFault.LIMIT_SWITCH, DeviceFault.EMERGENCY_STOP)


class StopOnLinkLoss(StrEnum):
    """What is known of a device's own reaction to a lost link."""

    VERIFIED = "verified"
    ASSUMED = "assumed"
    NONE = "absent"


class ControlMode(StrEnum):
    """How a load frame is brought to a load."""

    LOAD = "load"
    """By its own closed loop: it takes a target load and a rate."""
    DISPLACEMENT = "displacement"
    """By short ways of its crosshead, which semlive orders one after the other."""
    MANUAL = "manual"
    """By a person, or not at all."""


class StageKind(StrEnum):
    """What a translation moves: the specimen, or the beam."""

    SPECIMEN = "specimen"
    BEAM = "beam"


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """Who answers at the other end.

    Attributes:
        name: the device's name, version included if it tells.
        simulated: the device says it is a simulator.
        stop_on_link_loss: what is known of the device's own watchdog.
        force_max_n: the device's own force limit, if it has one.
        control: how it is brought to a load.
        force_resolution_n: smallest change of the force reading, N; 0 where the number format sets none.
        extension_resolution_mm: the same of the extension, mm.
        measures_extension: False if `extension_mm` of its readings is always 0.
        stiffness_n_mm: largest stiffness of specimen, grips and machine in series, as configured, N/mm; None if it is not stated.
        rate_min_n_s: slowest change of load that it can be ordered, N/s; 0 if none is known.
    """

    name: str
    simulated: bool
    stop_on_link_loss: StopOnLinkLoss
    force_max_n: float | None = None
    control: ControlMode = ControlMode.LOAD
    force_resolution_n: float = 0.0
    extension_resolution_mm: float = 0.0
    measures_extension: bool = True
    stiffness_n_mm: float | None = None
    rate_min_n_s: float = 0.0


@dataclass(frozen=True, slots=True)
class LoadSample:
    """One reading of the load frame.

    Attributes:
        sequence: counts readings of this link, from 0.
        time_ns: experiment time when the answer was received, UTC ns.
        mono_ns: monotonic clock at the same instant (wall ns).
        force_n: tension positive.
        extension_mm: crosshead extension.
        motion: by the device's own word.
        target_n: the load that the device is going to or holding.
        simulator_lag_s: how far a simulator is behind its own clock; None for real devices.
        raw: the registers as read.
        gage_strain: what a strain gage on the specimen says, tension positive; None without one, or while it says nothing.
        trouble: why the device is in fault, where it tells; None otherwise.
        rtt_s: how long the answer took (wall s); None if nobody looked.
        counted: the device's own count of readings, and at how many that begins anew; not logged by itself, it stands in `raw`.
        order_changed: how the device's own target, rate or command differs from what was last written there, as a sentence: another
            program or a person commands it, or it was restarted; None if it agrees or cannot be read.
        orders_cleared: `order_changed` concerns values that are all 0 in the device, as after a restart.
    """

    sequence: int
    time_ns: int
    mono_ns: int
    force_n: float
    extension_mm: float
    motion: MotionState
    target_n: float
    simulator_lag_s: float | None = None
    raw: tuple[int, ...] = ()
    gage_strain: float | None = None
    trouble: DeviceFault | None = None
    rtt_s: float | None = None
    counted: tuple[int, int] | None = None
    order_changed: str | None = None
    orders_cleared: bool = False


@dataclass(frozen=True, slots=True)
class StageSample:
    """One reading of the specimen stage.

    Attributes:
        sequence: counts readings of this link, from 0.
        time_ns: experiment time when the answer was received, UTC ns.
        mono_ns: monotonic clock at the same instant (wall ns).
        x_um: the stage's own reading, relative to its zero.
        y_um: likewise.
        motion: by the device's own word.
        raw: the registers as read.
        rtt_s: how long the answer took (wall s); None if nobody looked.
    """

    sequence: int
    time_ns: int
    mono_ns: int
    x_um: float
    y_um: float
    motion: MotionState
    raw: tuple[int, ...] = ()
    rtt_s: float | None = None


@dataclass(frozen=True, slots=True)
class FrameLoad:
    """The load while one frame was scanned, in N, and what a strain gage said meanwhile.

    Attributes:
        before_n: at the start of the scan.
        after_n: at the end of the scan.
        mean_n: mean over the scan.
        sd_n: standard deviation over the scan.
        gage_strain: mean of the strain gage over the scan; None without one.
        gage_strain_sigma: standard uncertainty of that mean from the scatter of the readings, without the gage's own calibration.
    """

    before_n: float
    after_n: float
    mean_n: float
    sd_n: float
    gage_strain: float | None = None
    gage_strain_sigma: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LoadSeries:
    """Load and extension as sampled.

    Attributes:
        time_ns: (n,) experiment time, UTC ns.
        force_n: (n,) force, tension positive.
        extension_mm: (n,) crosshead extension.
        gage_strain: (n,) strain gage, NaN where it said nothing; None without one.
    """

    time_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    extension_mm: NDArray[np.float64]
    gage_strain: NDArray[np.float64] | None = None
