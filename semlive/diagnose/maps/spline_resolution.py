"""Test of spline resolution: drift or distortion finer than the knots is assigned to the baseline before any named effect.

Sutton 2007 has no such test. If a spline is too coarse, its residual is distributed over effects of the dictionary.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid
from semlive.diagnose.baseline.bayes_factor import CandidateEvidence
from semlive.diagnose.maps.refinement import refined
from semlive.model.effects import BasisField, EffectClass, RunGeometry
from semlive.model.effects.effect_class import Values
from semlive.model.effects.run_geometry import xy_columns

Array = NDArray[np.float64]

SIZES_PX = (3e-4, 1.0)
# Periods in knots: a cubic spline follows a wave of two knots not at all and a wave of four by nine tenths; shorter ones are row effects.
DRIFT_KNOTS = (1.25, 4.0)
MAX_RATES = 150  # four amplitudes each
MAX_FRAME_COLUMNS = 800
# Of a baseline with its fine-scale terms. With 2,281, and 264 more in a second step, a run needed 231 s of processor time and 3.3 GB.
MAX_PARAMETERS = 2_200
DISTORTION_KNOTS, MIN_WAVE_BLOCKS = 2.3, 2.0  # longest wave finer than the spline, in knots, and shortest observable wave, in blocks


def _fine_drift(scene: RunGeometry, values: Values) -> BasisField:
    """Waves of all periods between the limits, with amplitudes proportional to the period as in a random walk.

    In long runs with long pauses only the longest periods are included, because their amplitudes are the largest.
    """
    del values
    fastest, slowest = (1.0 / (knots * scene.drift_knot_s) for knots in DRIFT_KNOTS)
    rates = np.arange(slowest, fastest, 1.0 / scene.end_s)[:MAX_RATES]
    columns = []
    for rate in rates:
        phase, size = 2.0 * np.pi * rate * scene.time_s, rates[0] / rate
        columns += [xy_columns(size * np.sin(phase)), xy_columns(size * np.cos(phase))]
    return BasisField(np.concatenate(columns, axis=-1), random_amplitude=("rms_px", "px", 1.0))


def _fine_drift_of_frames(scene: RunGeometry, values: Values) -> BasisField:
    """Cosines over the time of each frame by itself, with amplitudes proportional to the period as in a random walk.

    The longest is finer than the spline, the shortest alternates between neighbouring rows of blocks. Waves over the complete run
    followed a random walk of 0.044 px in a frame of 120 s less well (log Bayes factors of 289 and 559), and its rest was identified as a
    jump.
    """
    del values
    duration_s = float(np.ptp(scene.time_in_frame_s, axis=1).max())
    lowest = max(1, math.ceil(2.0 * duration_s / (DRIFT_KNOTS[1] * scene.drift_knot_s)))
    rows = round(float(np.ptp(scene.address_px[0, :, 1])) / _block_distance_px(scene))
    highest = max(lowest, min(rows, lowest + MAX_FRAME_COLUMNS // (2 * len(scene.frame)) - 1))
    phase = np.pi * (scene.time_in_frame_s - scene.time_in_frame_s.min()) / duration_s
    columns, frames = [], np.arange(len(scene.frame))
    for count in range(lowest, highest + 1):
        wave = np.cos(count * phase) * (lowest / count)
        columns += [xy_columns((frames == frame)[:, None] * wave) for frame in frames]
    return BasisField(np.concatenate(columns, axis=-1), random_amplitude=("rms_px", "px", 1.0))


def _fine_distortion(scene: RunGeometry, values: Values) -> BasisField | None:
    """Standing waves at the scan address; None if the blocks are too large to resolve any."""
    del values
    low, high = scene.address_px.min(axis=(0, 1)), scene.address_px.max(axis=(0, 1))
    size_px, block_px = high - low, _block_distance_px(scene)
    x, y = np.moveaxis((scene.address_px - low) / size_px, -1, 0)
    longest_px, shortest_px = DISTORTION_KNOTS * scene.distortion_knot_px, MIN_WAVE_BLOCKS * block_px
    counts = (2.0 * size_px / shortest_px).astype(int) + 1
    waves = [(float(np.hypot(*(0.5 * np.array((i, j)) / size_px))), i, j) for i in range(counts[0]) for j in range(counts[1])]
    waves = [wave for wave in sorted(waves) if 1.0 / longest_px <= wave[0] <= 1.0 / shortest_px]
    if not waves:
        return None
    columns = [xy_columns(np.cos(np.pi * i * x) * np.cos(np.pi * j * y)) for _, i, j in waves]
    return BasisField(np.concatenate(columns, axis=-1), random_amplitude=("rms_px", "px", 1.0))


def _block_distance_px(scene: RunGeometry) -> float:
    """Distance between neighbouring blocks, px."""
    spacing_px = np.diff(np.sort(scene.address_px[0, :, 0]))
    return float(np.median(spacing_px[spacing_px > 0.1 * spacing_px.max()]))


FINE_DRIFT = EffectClass("baseline_drift_underresolved", "the drift is finer than the knots of its spline", _fine_drift, sizes_px=SIZES_PX)
FINE_DRIFT_OF_FRAMES = EffectClass(
    "baseline_drift_underresolved_in_frames",
    "the drift in each frame is finer than the knots of its spline",
    _fine_drift_of_frames,
    sizes_px=SIZES_PX,
)
FINE_DISTORTION = EffectClass(
    "baseline_distortion_underresolved", "the distortion is finer than the knots of its spline", _fine_distortion, sizes_px=SIZES_PX
)


FINE_SCALE_CLASSES = (FINE_DISTORTION, FINE_DRIFT, FINE_DRIFT_OF_FRAMES)


def fine_scale_candidates(baseline: HyperparameterGrid) -> tuple[EffectClass, ...]:
    """Candidates for components finer than the splines. Drift is included only if it wanders; a smooth drift has no fine components."""
    prior_choice = baseline.best.prior_choice
    return FINE_SCALE_CLASSES if prior_choice is not None and prior_choice[0].random_walk_px else (FINE_DISTORTION,)


def has_room_for_terms(baseline: HyperparameterGrid) -> bool:
    """Whether fine-scale terms, two for each frame at least, can be added to a baseline."""
    return baseline.design.size + 2 * baseline.design.observation.frames <= MAX_PARAMETERS


def add_fine_scale_terms(baseline: HyperparameterGrid, scored: HyperparameterGrid, candidate: CandidateEvidence) -> HyperparameterGrid:
    """Add fine-scale terms to the baseline, the longest waves first; they are not reported as effects.

    Args:
        baseline: the baseline without effects.
        scored: the baseline by which the candidate was scored, with the effects so far.
        candidate: the fine-scale terms.
    """
    effect = refined(scored, candidate).baseline_effect
    longest = effect.columns[..., : MAX_PARAMETERS - baseline.design.size]
    return build_grid(baseline.design.with_effects(replace(effect, columns=longest)))
