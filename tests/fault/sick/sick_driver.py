"""A load frame, a stage and a trigger with faults that are switched on by files in the folder `ills`.

A refusal whose file contains a number ends after this number of calls.

Drivers of a laboratory are not part of semlive: with any fault of a driver, the daemon must end with the machine at rest.
Every call is recorded in the file `calls` in the same folder.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StageKind, StageSample, StopOnLinkLoss
from semlive.errors import LinkError
from semlive.ports import ClockSource

RATE_N_S = 10.0


class Sick:
    """Base class of the devices: the folder of faults."""

    def __init__(self, settings: Mapping[str, object], clock: ClockSource) -> None:
        self._faults = Path(str(settings["ills"]))
        self._name = str(settings["name"])
        self._clock = clock
        self._sequence = 0
        self._call("open")

    @property
    def identity(self) -> DeviceIdentity:
        return DeviceIdentity("sick", simulated=True, stop_on_link_loss=StopOnLinkLoss.NONE)

    @property
    def kind(self) -> StageKind:
        return StageKind.SPECIMEN

    def close(self) -> None:
        self._call("close")

    def stop(self) -> None:
        self._call("stop")

    def scan_once(self) -> None:
        self._call("scan_once")

    def _has(self, fault: str) -> bool:
        return (self._faults / fault).exists()

    def _refuses(self, what: str) -> bool:
        path = self._faults / f"{self._name} is refused {what}"
        if not path.exists():
            return False
        remaining = path.read_text(encoding="utf-8")
        if remaining == "1":
            path.unlink()
        elif remaining:
            path.write_text(str(int(remaining) - 1), encoding="utf-8")
        return True

    def _call(self, what: str) -> None:
        with (self._faults / "calls").open("a", encoding="utf-8") as calls:
            calls.write(f"{self._name} {what}\n")
        while self._has(f"{self._name} hangs in {what}"):
            time.sleep(0.02)
        if self._refuses(what):
            raise LinkError(f"{what} is refused")
        if self._has(f"{self._name} breaks in {what}"):
            raise RuntimeError(f"a mistake in {what}")

    def _next(self) -> int:
        self._sequence += 1
        # No number: the sample does not match the schema of the log any more.
        return self._sequence if not self._has(f"{self._name} raves") else cast(Any, "raving")


class SickLoadFrame(Sick):
    """A load frame that ramps at a fixed rate until it is stopped."""

    def __init__(self, settings: Mapping[str, object], clock: ClockSource) -> None:
        super().__init__(settings, clock)
        self._start_n, self._target_n, self._start_s = 0.0, 0.0, time.monotonic()

    def read(self) -> LoadSample:
        self._call("read")
        motion = MotionState.MOVING if self._force_n() < self._target_n else MotionState.STOPPED
        return LoadSample(self._next(), self._clock.now_ns(), self._clock.mono_ns(), self._force_n(), 0.0, motion, self._target_n)

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        self._call("ramp_to")
        self._start_n, self._target_n, self._start_s = self._force_n(), force_n, time.monotonic()

    def stop(self) -> None:
        super().stop()
        self._target_n = self._start_n = self._force_n()

    def _force_n(self) -> float:
        return min(self._target_n, self._start_n + RATE_N_S * (time.monotonic() - self._start_s))


class SickStage(Sick):
    """A stage that is always at rest."""

    def read(self) -> StageSample:
        self._call("read")
        return StageSample(self._next(), self._clock.now_ns(), self._clock.mono_ns(), 0.0, 0.0, MotionState.STOPPED)

    def move_to(self, x_um: float, y_um: float) -> None:
        self._call("move_to")
