"""Readings of load frame and stage, properties of these devices, and the load during a frame or a run."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class MotionState(StrEnum):
    """State of motion that a device reports."""

    STOPPED = "stopped"
    MOVING = "moving"
    FAULT = "fault"


class DeviceFault(StrEnum):
    """Cause of a fault that a device reports."""

    OVERLOAD = "overload"
    WATCHDOG = "watchdog"
    LIMIT_SWITCH = "limit switch"
    EMERGENCY_STOP = "emergency stop"

    @property
    def is_emergency(self) -> bool:
        """True if a limit switch or an emergency stop of the machine acted, independent of any program."""
        return self in (DeviceFault.LIMIT_SWITCH, DeviceFault.EMERGENCY_STOP)


class StopOnLinkLoss(StrEnum):
    """Evidence that a device stops by itself after loss of its link."""

    VERIFIED = "verified"
    ASSUMED = "assumed"
    NONE = "absent"


class ControlMode(StrEnum):
    """How a load frame reaches a load."""

    LOAD = "load"
    """Closed loop of the load frame: semlive commands a target load and a rate."""
    DISPLACEMENT = "displacement"
    """Short crosshead moves, which semlive commands in sequence."""
    MANUAL = "manual"
    """Moves by a person, or no loading."""


class StageKind(StrEnum):
    """Whether a translation moves the specimen or the beam."""

    SPECIMEN = "specimen"
    BEAM = "beam"


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """Identity and properties of a connected device.

    Attributes:
        name: the device's name, with its version if available.
        simulated: whether the device reports itself as a simulator.
        stop_on_link_loss: evidence for a watchdog in the device.
        force_max_n: force limit of the device, N; None if there is none.
        control: how it reaches a load.
        force_resolution_n: smallest change of the force reading, N; 0 where the number format does not limit it.
        extension_resolution_mm: smallest change of the extension reading, mm; 0 likewise.
        measures_extension: False if `extension_mm` of its readings is always 0.
        stiffness_n_mm: largest stiffness of specimen, grips and machine in series, as configured, N/mm; None if it is not stated.
        rate_min_n_s: smallest load rate that the device accepts, N/s; 0 if unknown.
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
        motion: state of motion that the device reports.
        target_n: load that the device approaches or holds.
        simulator_lag_s: lag of a simulator behind its own clock; None for real devices.
        raw: the registers as read.
        gage_strain: reading of a strain gage on the specimen, tension positive; None without a gage or a valid reading.
        trouble: cause of a fault, if the device reports it; None otherwise.
        rtt_s: round-trip time of the request (wall s); None if not measured.
        counted: the device's counter of readings and its modulus; it is logged as part of `raw`.
        order_changed: message about a target, rate or command in the device that differs from the last one written: another program or
            a person commands it, or it was restarted; None if it agrees or cannot be read.
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
        x_um: reading of the stage along x, relative to its zero.
        y_um: reading of the stage along y, relative to its zero.
        motion: state of motion that the device reports.
        raw: the registers as read.
        rtt_s: round-trip time of the request (wall s); None if not measured.
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
    """Load and strain gage reading while one frame was scanned.

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
        gage_strain: (n,) strain gage, NaN without a valid reading; None without a gage.
    """

    time_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    extension_mm: NDArray[np.float64]
    gage_strain: NDArray[np.float64] | None = None
