"""Load frame at rest: allowed changes while no motion is ordered, and faults.

While a step settles, is held or imaged, no motion is ordered. The load of a held specimen may relax slowly, against the direction of the
last ramp, at an unchanged extension: the load frame then approaches its target again. semlive did not cause any other change: a device
that reports motion, a load or position that exceeds its tolerance in another way, a force reading that is frozen while the crosshead
moves. Each is a fault of its own kind, because a motion back to the target would hide it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample, MotionState
from semlive.engine.supervision.reading_noise import NO_READINGS, ReadingNoise

UNORDERED_MOTION_S = 2.0
"""Longest reported motion of a device at rest, s: closed loops make corrections at times."""
_CONSTANT_S = 1.0
"""Shortest time of a constant force reading that the rule of a frozen reading uses, s."""


@dataclass(frozen=True, slots=True)
class Rest:
    """State of the load frame while no motion is ordered.

    Attributes:
        since: the first sample of this rest; None while a motion is ordered.
        before: the first sample of the previous rest, or the first sample of the run; with `since` it determines the stiffness.
        still: the sample since which the force reading is exactly constant.
        moving_since_ns: experiment time since which the device reports motion; None without reported motion.
        extension_noise: noise of the extension reading.
        flicker_mm: smallest change of the extension at earlier rests, the step of a coarse encoder; 0 before the first change.
        step_mm: smallest change at this rest, infinite before the first change.
    """

    since: LoadSample | None = None
    before: LoadSample | None = None
    still: LoadSample | None = None
    moving_since_ns: int | None = None
    extension_noise: ReadingNoise = NO_READINGS
    flicker_mm: float = 0.0
    step_mm: float = math.inf

    def with_sample(self, sample: LoadSample, ordered: bool) -> Rest:
        """Return the state after one more reading.

        Args:
            sample: reading of the load frame.
            ordered: a motion is ordered, so the load frame is not at rest.
        """
        noise = self.extension_noise.with_reading(sample.extension_mm)
        if ordered:
            flicker_mm = self.step_mm if math.isfinite(self.step_mm) else self.flicker_mm
            return Rest(before=self.since or self.before or sample, extension_noise=noise, flicker_mm=flicker_mm)
        step_mm = abs(sample.extension_mm - self.extension_noise.recent[-1]) if self.extension_noise.recent else 0.0
        smallest_mm = min(self.step_mm, step_mm) if step_mm > 0.0 and self.since is not None else self.step_mm
        still = sample if self.still is None or sample.force_n != self.still.force_n else self.still
        moving_ns = (self.moving_since_ns or sample.time_ns) if sample.motion is MotionState.MOVING else None
        since = self.since or sample
        return replace(self, since=since, still=still, moving_since_ns=moving_ns, extension_noise=noise, step_mm=smallest_mm)

    @property
    def noise_mm(self) -> float:
        """Largest change of the extension that noise explains, mm."""
        return max(6.0 * self.extension_noise.sigma, 2.0 * self.extension_noise.resolution, 2.0 * self.flicker_mm)

    @property
    def stiffness_n_mm(self) -> float | None:
        """Load change per travel from the previous rest to this one, N/mm; None if the travel is too short."""
        if self.since is None or self.before is None:
            return None
        travel_mm = abs(self.since.extension_mm - self.before.extension_mm)
        if travel_mm <= 5.0 * self.noise_mm or travel_mm <= 0.0:
            return None
        return abs(self.since.force_n - self.before.force_n) / travel_mm

    def problem(
        self, sample: LoadSample, target_n: float | None, tolerance_n: float, last_ramp_sign: float
    ) -> tuple[FaultCode, str] | None:
        """Return code and message of a change that semlive did not order, or None.

        Args:
            sample: the newest reading.
            target_n: load to hold, N; None without one.
            tolerance_n: allowed deviation of the load, N.
            last_ramp_sign: +1 after a ramp upwards, -1 after a ramp downwards, 0 without a ramp.
        """
        moving_s = 0.0 if self.moving_since_ns is None else (sample.time_ns - self.moving_since_ns) / 1e9
        if moving_s > UNORDERED_MOTION_S:
            what = f"the load frame has reported motion for {moving_s:.1f} s, which semlive did not order"
            return FaultCode.UNORDERED_MOTION, f"{what}: check who moves it"
        return self._load_moved(sample, target_n, tolerance_n, last_ramp_sign) or self._frozen(sample, tolerance_n)

    def _load_moved(
        self, sample: LoadSample, target_n: float | None, tolerance_n: float, last_ramp_sign: float
    ) -> tuple[FaultCode, str] | None:
        if target_n is None or self.since is None:
            return None
        error_n = sample.force_n - target_n
        if abs(error_n) <= tolerance_n or self._relaxed(sample, error_n, last_ramp_sign):
            return None
        what = f"the load went from {target_n:.1f} to {sample.force_n:.1f} N while nothing was ordered"
        return FaultCode.MOVED_AT_REST, f"{what}: check who moved the load frame, or what the specimen did; semlive does not drive it back"

    def _relaxed(self, sample: LoadSample, error_n: float, last_ramp_sign: float) -> bool:
        """Whether the load changed against its last ramp, at rest and at an unchanged extension."""
        assert self.since is not None
        travel_mm = abs(sample.extension_mm - self.since.extension_mm)
        direction = last_ramp_sign or math.copysign(1.0, sample.force_n)
        against = error_n * direction < 0
        return against and self.moving_since_ns is None and travel_mm <= self.noise_mm

    def _frozen(self, sample: LoadSample, tolerance_n: float) -> tuple[FaultCode, str] | None:
        still, stiffness = self.still, self.stiffness_n_mm
        if still is None or stiffness is None or (sample.time_ns - still.time_ns) / 1e9 < _CONSTANT_S:
            return None
        travel_mm = abs(sample.extension_mm - still.extension_mm)
        if stiffness * travel_mm <= 2.0 * tolerance_n or travel_mm <= 2.0 * self.noise_mm:
            return None
        what = f"the crosshead moved {travel_mm:.4f} mm while the force reading was constant at {sample.force_n:.1f} N"
        return FaultCode.FROZEN_READING, f"{what}: check the load cell, and who moved the load frame"


NO_REST = Rest()
"""Before the first reading."""
