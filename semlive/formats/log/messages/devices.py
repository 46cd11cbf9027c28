"""Messages with readings of the devices."""

from __future__ import annotations

from semlive.data.loading import DeviceFault, MotionState
from semlive.formats.log.messages.base import BootStamped


class LoadSampleMessage(BootStamped):
    """`/load_frame/sample`: one reading, with the registers as read (see `semlive.data.loading.LoadSample`)."""

    sequence: int
    time_ns: int
    mono_ns: int
    force_n: float
    extension_mm: float
    motion: MotionState
    target_n: float
    simulator_lag_s: float | None = None
    raw: tuple[int, ...]
    gage_strain: float | None = None
    trouble: DeviceFault | None = None
    rtt_s: float | None = None


class StageSampleMessage(BootStamped):
    """`/stage/sample`: one reading, with the registers as read (see `semlive.data.loading.StageSample`)."""

    sequence: int
    time_ns: int
    mono_ns: int
    x_um: float
    y_um: float
    motion: MotionState
    raw: tuple[int, ...]
    rtt_s: float | None = None
