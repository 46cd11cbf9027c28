"""Supervision of a machine that a person moves: travel of the crosshead that the load reading does not follow.

A person may pause, go slower or overshoot, so neither rate nor arrival is judged. But a reading that stands still while the crosshead moves
hides the true load. The stiffness is learned from the readings, because nothing states it for such a machine.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample
from semlive.engine.supervision.ramp_supervision import Finding
from semlive.engine.supervision.reading_noise import ReadingNoise

REACTION_S = 1.0
"""Time in which a person stops the machine after the request; the load grows meanwhile."""
_LEARNED_CHANGES = 5.0
"""A stiffness is learned from a change of load of so many noticeable changes, and of travel of so many steps of the extension."""


@dataclass(frozen=True, slots=True)
class HandSupervision:
    """What the readings show since a person was last requested to move the machine.

    Attributes:
        limits: of the run.
        noticeable_n: change of the load that is no noise, N; the tolerance of the order.
        rate_n_s: ordered rate, N/s.
        extension: steps of the extension reading.
        segment: reading from which the next stiffness is learned; None before the first reading.
        anchor: reading at which the load last changed noticeably.
        constant: first of the latest readings that are exactly equal.
        stiffness_n_mm: largest stiffness learned so far, N/mm; None before the first.
    """

    limits: Limits
    noticeable_n: float = 1.0
    rate_n_s: float = 0.0
    extension: ReadingNoise = field(default_factory=ReadingNoise)
    segment: LoadSample | None = None
    anchor: LoadSample | None = None
    constant: LoadSample | None = None
    stiffness_n_mm: float | None = None

    def ordered(self, rate_n_s: float, tolerance_n: float) -> HandSupervision:
        """A person is requested to go to a load at a rate (N/s), to within a tolerance (N)."""
        return replace(self, rate_n_s=rate_n_s, noticeable_n=tolerance_n, segment=None, anchor=None, constant=None)

    def with_sample(self, sample: LoadSample) -> tuple[HandSupervision, Finding | None]:
        """One reading more.

        Returns:
            The supervision, and why the person must stop, or None.
        """
        extension = self.extension.with_reading(sample.extension_mm)
        if self.segment is None or self.anchor is None or self.constant is None:
            return replace(self, extension=extension, segment=sample, anchor=sample, constant=sample), None
        seen = replace(
            self,
            extension=extension,
            anchor=sample if abs(sample.force_n - self.anchor.force_n) >= self.noticeable_n else self.anchor,
            constant=self.constant if sample.force_n == self.constant.force_n else sample,
        )
        seen = _learned(seen, self.segment, sample)
        return seen, _frozen(seen, self.constant, sample) or _hidden(seen, sample)


def _learned(seen: HandSupervision, segment: LoadSample, sample: LoadSample) -> HandSupervision:
    change_n = sample.force_n - segment.force_n
    travel_mm = sample.extension_mm - segment.extension_mm
    too_short = abs(travel_mm) < _LEARNED_CHANGES * seen.extension.smallest_step or change_n * travel_mm <= 0.0
    if abs(change_n) < _LEARNED_CHANGES * seen.noticeable_n or too_short:
        return seen
    return replace(seen, segment=sample, stiffness_n_mm=max(seen.stiffness_n_mm or 0.0, change_n / travel_mm))


def _frozen(seen: HandSupervision, constant: LoadSample, sample: LoadSample) -> Finding | None:
    """Readings that are exactly equal although the travel since the first of them is many noticeable changes of load."""
    travel_mm = abs(sample.extension_mm - constant.extension_mm)
    if sample.force_n != constant.force_n:
        return None
    hidden_n = (seen.stiffness_n_mm or 0.0) * travel_mm
    if hidden_n <= _LEARNED_CHANGES * seen.noticeable_n:
        return None
    what = f"the load reading is exactly {sample.force_n:.2f} N although the crosshead moved {travel_mm:.4f} mm, which is {hidden_n:.0f} N"
    return Finding(FaultCode.NO_RESPONSE, f"{what}: check the load cell, its amplifier and the program that records the file")


def _hidden(seen: HandSupervision, sample: LoadSample) -> Finding | None:
    """Travel since the last noticeable change of load that could bring the true load to its limit before the person has stopped."""
    if seen.anchor is None or seen.stiffness_n_mm is None:
        return None
    travel_mm = sample.extension_mm - seen.anchor.extension_mm
    limit_n = seen.limits.force_max_n if travel_mm > 0 else seen.limits.force_min_n
    hidden_n, headroom_n = seen.stiffness_n_mm * abs(travel_mm), abs(limit_n - seen.anchor.force_n)
    if hidden_n <= max(headroom_n - REACTION_S * seen.rate_n_s, _LEARNED_CHANGES * seen.noticeable_n):
        return None
    what = f"the crosshead moved {abs(travel_mm):.4f} mm while the load reading stayed at {sample.force_n:.1f} N"
    meaning = f"at {seen.stiffness_n_mm:.0f} N/mm that is {hidden_n:.0f} N, which would reach the limit of {limit_n:g} N"
    return Finding(FaultCode.TRAVEL_WITHOUT_LOAD, f"{what}; {meaning}: check cell and grips")
