"""Supervision of a manually operated machine: crosshead travel without a change of the load reading.

A person may pause, move more slowly or overshoot, so rate and arrival are not checked. But a constant reading during crosshead travel hides
the true load. The stiffness is learned from the readings, because it is not configured for such a machine.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample
from semlive.engine.supervision.ramp_supervision import Finding
from semlive.engine.supervision.reading_noise import ReadingNoise

REACTION_S = 1.0
"""Reaction time of a person who is requested to stop the machine, s; the load increases meanwhile."""
_LEARNED_CHANGES = 5.0
"""Smallest load change, in noticeable changes, and smallest travel, in steps of the extension, from which a stiffness is learned."""


@dataclass(frozen=True, slots=True)
class HandSupervision:
    """State of the supervision since the last request to move the machine.

    Attributes:
        limits: soft limits of the run.
        noticeable_n: smallest load change that exceeds the noise, N; the tolerance of the order.
        rate_n_s: ordered rate, N/s.
        extension: noise and steps of the extension reading.
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
        """Return the supervision after a request to ramp to a load at a rate (N/s), within a tolerance (N)."""
        return replace(self, rate_n_s=rate_n_s, noticeable_n=tolerance_n, segment=None, anchor=None, constant=None)

    def with_sample(self, sample: LoadSample) -> tuple[HandSupervision, Finding | None]:
        """Check one more reading.

        Returns:
            The updated supervision, and why the person must stop, or None.
        """
        extension = self.extension.with_reading(sample.extension_mm)
        if self.segment is None or self.anchor is None or self.constant is None:
            return replace(self, extension=extension, segment=sample, anchor=sample, constant=sample), None
        updated = replace(
            self,
            extension=extension,
            anchor=sample if abs(sample.force_n - self.anchor.force_n) >= self.noticeable_n else self.anchor,
            constant=self.constant if sample.force_n == self.constant.force_n else sample,
        )
        updated = _learned(updated, self.segment, sample)
        return updated, _frozen(updated, self.constant, sample) or _hidden(updated, sample)


def _learned(supervision: HandSupervision, segment: LoadSample, sample: LoadSample) -> HandSupervision:
    change_n = sample.force_n - segment.force_n
    travel_mm = sample.extension_mm - segment.extension_mm
    too_short = abs(travel_mm) < _LEARNED_CHANGES * supervision.extension.smallest_step or change_n * travel_mm <= 0.0
    if abs(change_n) < _LEARNED_CHANGES * supervision.noticeable_n or too_short:
        return supervision
    return replace(supervision, segment=sample, stiffness_n_mm=max(supervision.stiffness_n_mm or 0.0, change_n / travel_mm))


def _frozen(supervision: HandSupervision, constant: LoadSample, sample: LoadSample) -> Finding | None:
    """Test for exactly equal readings over a travel that corresponds to several noticeable load changes."""
    travel_mm = abs(sample.extension_mm - constant.extension_mm)
    if sample.force_n != constant.force_n:
        return None
    hidden_n = (supervision.stiffness_n_mm or 0.0) * travel_mm
    if hidden_n <= _LEARNED_CHANGES * supervision.noticeable_n:
        return None
    what = f"the load reading is exactly {sample.force_n:.2f} N although the crosshead moved {travel_mm:.4f} mm, which is {hidden_n:.0f} N"
    return Finding(FaultCode.NO_RESPONSE, f"{what}: check the load cell, its amplifier and the program that records the file")


def _hidden(supervision: HandSupervision, sample: LoadSample) -> Finding | None:
    """Test whether the travel since the last noticeable load change could bring the true load to its limit within the reaction time."""
    if supervision.anchor is None or supervision.stiffness_n_mm is None:
        return None
    travel_mm = sample.extension_mm - supervision.anchor.extension_mm
    limit_n = supervision.limits.force_max_n if travel_mm > 0 else supervision.limits.force_min_n
    hidden_n, headroom_n = supervision.stiffness_n_mm * abs(travel_mm), abs(limit_n - supervision.anchor.force_n)
    if hidden_n <= max(headroom_n - REACTION_S * supervision.rate_n_s, _LEARNED_CHANGES * supervision.noticeable_n):
        return None
    what = f"the crosshead moved {abs(travel_mm):.4f} mm while the load reading stayed at {sample.force_n:.1f} N"
    meaning = f"at {supervision.stiffness_n_mm:.0f} N/mm that is {hidden_n:.0f} N, which would reach the limit of {limit_n:g} N"
    return Finding(FaultCode.TRAVEL_WITHOUT_LOAD, f"{what}; {meaning}: check cell and grips")
