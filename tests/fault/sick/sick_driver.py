"""A load frame, a stage and a trigger that fall ill when a file of that name appears in the folder `ills`.

A refusal whose file holds a number is over after so many calls.

The drivers of a laboratory are written by others: whatever they do, the daemon must come to an end with the machine at rest.
Every call is noted in the file `calls` beside the ills.
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
    """What the devices share: a folder of ills."""

    def __init__(self, settings: Mapping[str, object], clock: ClockSource) -> None:
        self._ills = Path(str(settings["ills"]))
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

    def _has(self, ill: str) -> bool:
        return (self._ills / ill).exists()

    def _refuses(self, what: str) -> bool:
        path = self._ills / f"{self._name} is refused {what}"
        if not path.exists():
            return False
        left = path.read_text(encoding="utf-8")
        if left == "1":
            path.unlink()
        elif left:
            path.write_text(str(int(left) - 1), encoding="utf-8")
        return True

    def _call(self, what: str) -> None:
        with (self._ills / "calls").open("a", encoding="utf-8") as calls:
            calls.write(f"{self._name} {what}\n")
        while self._has(f"{self._name} hangs in {what}"):
            time.sleep(0.02)
        if self._refuses(what):
            raise LinkError(f"{what} is refused")
        if self._has(f"{self._name} breaks in {what}"):
            raise RuntimeError(f"a mistake in {what}")

    def _next(self) -> int:
        self._sequence += 1
        # No number: what is written down of a sample does not fit the log any more.
        return self._sequence if not self._has(f"{self._name} raves") else cast(Any, "raving")


class SickLoadFrame(Sick):
    """Ramps at a fixed rate for as long as it is not stopped."""

    def __init__(self, settings: Mapping[str, object], clock: ClockSource) -> None:
        super().__init__(settings, clock)
        self._from_n, self._to_n, self._began_s = 0.0, 0.0, time.monotonic()

    def read(self) -> LoadSample:
        self._call("read")
        motion = MotionState.MOVING if self._force_n() < self._to_n else MotionState.STOPPED
        return LoadSample(self._next(), self._clock.now_ns(), self._clock.mono_ns(), self._force_n(), 0.0, motion, self._to_n)

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        self._call("ramp_to")
        self._from_n, self._to_n, self._began_s = self._force_n(), force_n, time.monotonic()

    def stop(self) -> None:
        super().stop()
        self._to_n = self._from_n = self._force_n()

    def _force_n(self) -> float:
        return min(self._to_n, self._from_n + RATE_N_S * (time.monotonic() - self._began_s))


class SickStage(Sick):
    """Is where it was sent."""

    def read(self) -> StageSample:
        self._call("read")
        return StageSample(self._next(), self._clock.now_ns(), self._clock.mono_ns(), 0.0, 0.0, MotionState.STOPPED)

    def move_to(self, x_um: float, y_um: float) -> None:
        self._call("move_to")
