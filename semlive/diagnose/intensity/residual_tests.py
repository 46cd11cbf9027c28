"""Tests of the intensity residual: differences of frames, row bands and blocks between pairs beyond those within pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from semlive.diagnose.intensity.models import IntensityModel, IntensityRegression
from semlive.diagnose.intensity.time_series import OUTLIER_FACTOR, IntensityTimeSeries

Array = NDArray[np.float64]
BLUR_WEIGHT = 0.3
"""Fraction of the contrast removed by a blur of 1 px^2, at typical wavelengths of a pattern."""


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """One residual test.

    Attributes:
        what: tested quantity: frames, bands or blocks.
        p_value: p-value of this test alone.
        levels: root mean square of the residual, grey levels.
    """

    what: str
    p_value: float
    levels: float


def residual_tests(time_series: IntensityTimeSeries, intensity_models: Sequence[IntensityModel] = ()) -> tuple[ResidualTest, ...]:
    """The three tests, with models included in the fit."""
    white = IntensityRegression(time_series, tuple(intensity_models)).residual()
    freedom = sum(len(intensity_model.columns) for intensity_model in intensity_models)
    return (
        _tone(time_series, white, slice(0, 1), freedom),
        _tone(time_series, white, slice(1, None), freedom),
        _blocks(time_series, intensity_models),
    )


def _tone(time_series: IntensityTimeSeries, white: Array, part: slice, freedom: int) -> ResidualTest:
    """Test of the frame means, or of the differences between bands."""
    bands = time_series.value.shape[1]
    whole_frames = part.start == 0
    square, dof = 0.0, -freedom
    means = []
    for pair in np.unique(time_series.pair):
        own = white[time_series.pair == pair][:, part]
        means.append(own.mean(axis=0))
        square += len(own) * float(np.sum(means[-1] ** 2))
        dof += means[-1].size
    dof -= means[0].size
    if dof < 1:
        return ResidualTest("frames" if whole_frames else "bands", 1.0, 0.0)
    p_value = float(fdtrc(dof, time_series.freedom * (1 if whole_frames else 0.5 * bands), square / dof))
    back = np.stack(means) * np.sqrt(time_series.inflation if whole_frames else np.ones(4))
    averaged = back @ np.linalg.inv(time_series.whitener).T / np.sqrt(bands)
    noise = np.diag(time_series.covariance) / bands * 0.5
    weight = np.array([1.0, time_series.contrast, 1.0, BLUR_WEIGHT * time_series.contrast])
    excess = (np.mean(np.sum(averaged**2, axis=1), axis=0) - noise * (1 if whole_frames else bands - 1)) * weight**2
    return ResidualTest("frames" if whole_frames else "bands", p_value, float(np.sqrt(max(float(excess.sum()), 0.0))))


def _blocks(time_series: IntensityTimeSeries, intensity_models: Sequence[IntensityModel]) -> ResidualTest:
    """Test of the blocks beyond the tone of their frame; frames with a step have two tones and are left out."""
    steps = [intensity_model.at_s for intensity_model in intensity_models if intensity_model.at_s]
    whole_frames = np.array([not any(span[0, 0] <= at <= span[-1, 1] for at in steps) for span in time_series.span_s])
    local, pair = time_series.local[whole_frames], time_series.pair[whole_frames]
    complete_pairs = [value for value in np.unique(pair) if np.sum(pair == value) == 2]
    if len(complete_pairs) < 3:
        return ResidualTest("blocks", 1.0, 0.0)
    first = np.array([np.flatnonzero(pair == value)[0] for value in complete_pairs])
    change = local[first + 1] - local[first]
    energy = np.mean(change**2, axis=1)
    change = change[energy <= OUTLIER_FACTOR * np.median(energy)]
    noise = float(np.mean(change**2)) / 2.0
    means = 0.5 * (local[first] + local[first + 1])
    means = means - means.mean(axis=0)
    blocks, count = local.shape[1], len(complete_pairs)
    between = 2.0 * float(np.sum(means**2)) / (blocks * (count - 1))
    p_value = float(fdtrc(blocks * (count - 1), blocks * len(change), between / max(noise, 1e-18)))
    return ResidualTest("blocks", p_value, float(np.sqrt(max(between - noise, 0.0) / 2.0)))
