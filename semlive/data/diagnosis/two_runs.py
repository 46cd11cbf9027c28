"""The verdict of the comparison of two runs with different scans."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.diagnosis.effects import Outcome, ParameterEstimate


@dataclass(frozen=True, slots=True)
class SharedEffect:
    """An effect that runs with different scans show.

    Attributes:
        name: canonical.
        aliases: that it has by its parameters, the likeliest first.
        peak_px: the largest displacement that it causes at any point of any run; 0 where each run has its own.
        parameters: what is known of it; none where each run has its own.
    """

    name: str
    aliases: tuple[str, ...]
    peak_px: float
    parameters: tuple[ParameterEstimate, ...]


@dataclass(frozen=True, slots=True)
class ScanRotation:
    """What two runs say of which the second's scan was turned.

    Attributes:
        angle_rad: of the scan, x towards y positive.
        x_excess: of the scan's axes: u = e (x - xc), whether it has a name or not.
        skew: of them: u = skew (y - yc).
        follows: what the distortion goes with: ``column``, ``scan``, ``both``, ``neither``; empty where that cannot be told.
        of_scan: logarithm of the odds that some of it goes with the scan, against none.
    """

    angle_rad: ParameterEstimate
    x_excess: ParameterEstimate
    skew: ParameterEstimate
    follows: str
    of_scan: float


@dataclass(frozen=True, slots=True)
class TwoRunVerdict:
    """What runs with different scans say together.

    Attributes:
        outcome: NONE, IDENTIFIED, AMBIGUOUS or UNKNOWN.
        effect: the likeliest, or None.
        ambiguous: the names that would do, if more than one would.
        evidence: by name, the logarithm of the Bayes factor; the loudest first.
        apart: logarithm of the odds for a distortion of its own in each run against one for all.
        effects: that have a name, the likeliest first; only a turned scan shows more than one.
        turned: what the turn of a scan shows; None where none was turned.
    """

    outcome: Outcome
    effect: SharedEffect | None
    ambiguous: tuple[str, ...]
    evidence: tuple[tuple[str, float], ...]
    apart: float
    effects: tuple[SharedEffect, ...] = ()
    turned: ScanRotation | None = None
