"""The verdict of the comparison of two runs with different scans."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.diagnosis.effects import Outcome, ParameterEstimate


@dataclass(frozen=True, slots=True)
class SharedEffect:
    """An effect common to runs with different scans.

    Attributes:
        name: canonical name.
        aliases: names of special cases that its parameters match, the most likely first.
        peak_px: largest displacement by the effect at any point of any run.
        parameters: physical parameters; empty where they differ between the runs.
    """

    name: str
    aliases: tuple[str, ...]
    peak_px: float
    parameters: tuple[ParameterEstimate, ...]


@dataclass(frozen=True, slots=True)
class ScanRotation:
    """Result of two runs with a rotated scan in the second.

    Attributes:
        angle_rad: rotation of the scan, positive from x towards y.
        x_excess: excess gain e of the scan's x axis: u = e (x - xc), whether or not it is identified as an effect.
        skew: skew of the scan axes: u = skew (y - yc).
        follows: frame in which the distortion is fixed: ``column``, ``scan``, ``both``, ``neither``; empty if undetermined.
        of_scan: log-odds for a part of the distortion that rotates with the scan.
    """

    angle_rad: ParameterEstimate
    x_excess: ParameterEstimate
    skew: ParameterEstimate
    follows: str
    of_scan: float


@dataclass(frozen=True, slots=True)
class TwoRunVerdict:
    """Joint verdict of runs with different scans.

    Attributes:
        outcome: NONE, IDENTIFIED, AMBIGUOUS or UNKNOWN.
        effect: the most likely effect, or None.
        ambiguous: names of the candidates, if several explain the data.
        evidence: names and logarithms of the Bayes factors, largest first.
        separate_log_odds: log-odds for a separate distortion in each run against a common distortion.
        effects: identified effects, most likely first; more than one only with a rotated scan.
        turned: result of a rotated scan; None without rotation.
        pixel_ratio: pixel size of the last run relative to the first.
    """

    outcome: Outcome
    effect: SharedEffect | None
    ambiguous: tuple[str, ...]
    evidence: tuple[tuple[str, float], ...]
    separate_log_odds: float
    effects: tuple[SharedEffect, ...] = ()
    turned: ScanRotation | None = None
    pixel_ratio: float = 1.0
