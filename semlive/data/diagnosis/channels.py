"""Verdicts on the two channels that are measured on the images: row shifts and grey levels."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.diagnosis.effects import DomainTest, HeldOutMisfit, IdentifiedEffect, Outcome, ParameterEstimate


@dataclass(frozen=True, slots=True)
class RowDiagnosis:
    """What rows show that were registered by themselves: disparity maps average it over a subset.

    Attributes:
        outcome: of this channel.
        effects: that were named, or the closest.
        ambiguous: names that would do as well.
        gap: on what they were not fitted on; None where nothing was named.
        where: the two domains of rows, before any effect.
        evidence: before any effect was added, each name with the logarithm of its Bayes factor.
        pairs: that were looked at.
        rows: of each, at most.
        noise_px: standard deviation of a row's shift by noise alone.
        frequency_hz: of the spectrum, thinned to its peaks.
        power: there, a mean over pairs and axes in units of the noise.
        detection_threshold: power that one spectrum of noise in a hundred reaches anywhere.
    """

    outcome: Outcome
    effects: tuple[IdentifiedEffect, ...]
    ambiguous: tuple[str, ...]
    gap: HeldOutMisfit | None
    where: tuple[DomainTest, ...]
    evidence: tuple[tuple[str, float], ...]
    pairs: int
    rows: int
    noise_px: float
    frequency_hz: tuple[float, ...]
    power: tuple[float, ...]
    detection_threshold: float


@dataclass(frozen=True, slots=True)
class IntensityHistory:
    """How a quantity of the grey levels went over a run.

    Attributes:
        name: mean, gain, curvature or blur, against frame 1.
        unit: of it.
        value: of each frame.
        sigma: standard uncertainty of each.
        fitted: what the laws that were found make of it.
    """

    name: str
    unit: str
    value: tuple[float, ...]
    sigma: float
    fitted: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class IntensityDiagnosis:
    """What grey levels show: the tone and the sharpness of every frame against the first pair, on the same material.

    Attributes:
        outcome: of this channel.
        effects: that were named, or nothing.
        ambiguous: names that would do as well.
        where: the domain of intensity, before any effect.
        evidence: before any effect was added, each name with the logarithm of its Bayes factor.
        frames: that were looked at.
        blocks: of the specimen in each.
        noise: a and b of the variance a + b I of a pixel, grey levels squared and grey levels, each with its standard uncertainty.
        mean_levels: of the picture.
        contrast_levels: of the pattern.
        clipped: largest share of black or white pixels in a frame.
        time_s: middle of each frame's scan, seconds after the start of frame 0.
        histories: over those frames.
        left: what no law explains, one sentence; empty if nothing is left.
    """

    outcome: Outcome
    effects: tuple[IdentifiedEffect, ...]
    ambiguous: tuple[str, ...]
    where: tuple[DomainTest, ...]
    evidence: tuple[tuple[str, float], ...]
    frames: int
    blocks: int
    noise: tuple[ParameterEstimate, ParameterEstimate]
    mean_levels: float
    contrast_levels: float
    clipped: float
    time_s: tuple[float, ...]
    histories: tuple[IntensityHistory, ...]
    left: str = ""
