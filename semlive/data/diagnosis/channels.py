"""Verdicts on the two channels that are measured on the images: row shifts and grey levels."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.diagnosis.effects import DomainTest, HeldOutMisfit, IdentifiedEffect, Outcome, ParameterEstimate


@dataclass(frozen=True, slots=True)
class RowDiagnosis:
    """Verdict of the row channel, where each scan row is registered separately; disparity maps average rows over a subset.

    Attributes:
        outcome: outcome of this channel.
        effects: identified effects, or the most likely one.
        ambiguous: names of effects that explain the data equally well.
        gap: misfit on held-out pairs; None if no effect was identified.
        where: tests of the two row domains, before any effect.
        evidence: names and logarithms of the Bayes factors of all candidates, before any effect.
        pairs: number of pairs.
        rows: largest number of rows in a pair.
        noise_px: standard deviation of a row's shift by image noise.
        frequency_hz: frequencies of the spectrum, thinned to its peaks.
        power: mean power over pairs and axes, in units of the noise.
        detection_threshold: maximum power that one in a hundred spectra of noise exceeds.
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
    """One intensity quantity over the frames of a run.

    Attributes:
        name: mean, gain, curvature or blur, relative to frame 1.
        unit: unit of value, sigma and fitted.
        value: value of each frame.
        sigma: standard uncertainty of each value.
        fitted: value of each frame by the fitted intensity models.
    """

    name: str
    unit: str
    value: tuple[float, ...]
    sigma: float
    fitted: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class IntensityDiagnosis:
    """Verdict of the intensity channel: tone and sharpness of every frame against the first pair, at the same material points.

    Attributes:
        outcome: outcome of this channel.
        effects: identified effects; empty if none.
        ambiguous: names of effects that explain the data equally well.
        where: test of the intensity domain, before any effect.
        evidence: names and logarithms of the Bayes factors of all candidates, before any effect.
        frames: number of frames.
        blocks: number of blocks of the specimen in each frame.
        noise: a and b of the variance a + b I of a pixel, grey levels squared and grey levels, each with its standard uncertainty.
        mean_levels: mean grey level of the image.
        contrast_levels: contrast of the pattern, grey levels.
        clipped: largest fraction of black or white pixels in a frame.
        time_s: middle of each frame's scan, seconds after the start of frame 0.
        histories: intensity quantities over these frames.
        unexplained: message about a residual that no intensity model explains; empty if there is none.
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
    unexplained: str = ""
