"""True noise of a simulated microscope: that of further frames without drift, distortion and moves, at the shifts of the real pairs.

Each pair is taken several times with other noise and other phases of its waves. The scatter of these gives the uncertainty of the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from qualify_raster import GAUGE_PX, ROW_EFFECTS, Array, Raster

from semlive import dic, mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.strain import Displacement
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.distortion import AxisDistortion, Distortion
from semlive_simulators.effects.drift import AxisDrift, Drift
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.protocol_player import ScannedFrame
from semlive_simulators.specimen.specimen import at_rest

GAUGE_POINTS = 5
"""Points along a gauge whose noise is the true one."""
STILL_AXIS = AxisDrift(0.0, 1.0, 0.0, 0.0)
FLAT_AXIS = AxisDistortion(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
LATER_S = 5000.0
"""Begin of the further frames, after those of the run, and time from one repetition of all pairs to the next."""
REPEATS, REPEATS_OF_ROW_MOTION = 2, 4
"""Pairs of each shift. With motion of the rows the noise of one pair depends on the difference of two phases."""
Images = tuple[NDArray[np.unsignedinteger], NDArray[np.unsignedinteger]]
Maps = Sequence[Sequence[DisparityMap]]
"""Maps by pair and repetition."""


@dataclass(frozen=True, slots=True)
class Truth:
    """A true value with its standard uncertainty, which is 0 if it is known exactly."""

    value: float
    sigma: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """Pairs of a microscope without drift, distortion and moves.

    Attributes:
        images: first and second frame of each pair, by pair and repetition.
    """

    images: tuple[tuple[Images, ...], ...]

    @classmethod
    def of(cls, scenario: Scenario, shots: Sequence[ScannedFrame], raster: Raster, *, row_effects: bool) -> Still:
        """Render pairs with the shift within each pair of a run and other noise."""
        chosen = tuple(member for member in scenario.effects.members if row_effects and isinstance(member, ROW_EFFECTS))
        still = replace(
            scenario, drift=Drift(STILL_AXIS, STILL_AXIS), distortion=Distortion(FLAT_AXIS, FLAT_AXIS), effects=EffectSet(chosen)
        )
        column, images = still.column(), []
        for pair in range(len(shots) // 2):
            ends = shots[2 * pair : 2 * pair + 2]
            moved = raster.rate_px_s(shots, pair) * (ends[1].start_s - ends[0].start_s)
            stop, pairs = np.array(ends[0].stop.shift_px), list[Images]()
            for repeat in range(1, 1 + (REPEATS_OF_ROW_MOTION if chosen else REPEATS)):
                first, second = (
                    render_frame(still, repeat * LATER_S + end.start_s, at_rest(stop + at * moved), repeat * len(shots) + end.frame, column)
                    for at, end in enumerate(ends)
                )
                pairs.append((first, second))
            images.append(tuple(pairs))
        return cls(tuple(images))

    def maps(self, subset_px: int, step_px: int) -> list[list[DisparityMap]]:
        """Maps of all pairs, by pair and repetition."""
        settings = dic.DicSettings(subset_px=subset_px, step_px=step_px, roi_px=None, method="subset")
        height, width = self.images[0][0][0].shape
        grid = dic.grid_for(settings, width, height)
        return [
            [
                dic.correlate(dic.prepare(first, grid, settings), second, settings, reference_frame=0, current_frame=1)
                for first, second in pairs
            ]
            for pairs in self.images
        ]


def _largest(variances: Array) -> Truth:
    """Root of the largest mean variance of the components, (pairs, repetitions, components), and its uncertainty by the repetitions."""
    pairs, repeats, _ = variances.shape
    mean = variances.mean(axis=(0, 1))
    worst = int(np.argmax(mean))
    value = float(np.sqrt(mean[worst]))
    of_mean = np.sqrt(float(np.sum(np.var(variances[:, :, worst], axis=1, ddof=1))) / repeats) / pairs
    return Truth(value, of_mean / (2.0 * value))


def displacement_noise(maps: Maps, *, jitter: bool = False) -> Truth:
    """Noise of a displacement of the noisier axis about the mean motion of a map.

    A wave along y changes that mean by up to 0.02 px with its phases, which is measured as motion of the specimen.

    Args:
        maps: maps by pair and repetition.
        jitter: the rows have white jitter, so that a mean over n subsets along y takes 1/n of their variance.
    """
    return _largest(np.array([[[_variance(one, values, jitter) for values in (one.u_px, one.v_px)] for one in pairs] for pairs in maps]))


def _variance(found: DisparityMap, values: Array, jitter: bool) -> float:
    variance = float(np.var(values[found.valid]))
    if not jitter:
        return variance
    rows = values[found.valid.any(axis=1)].mean(axis=1)
    return variance + float(np.var(rows)) / (found.grid.ny * found.grid.step_px / found.grid.subset_px - 1.0)


def strain_noise(maps: Maps) -> Truth:
    """Noise of the strain of the reference gauge, the noisiest of exx, eyy and exy.

    With vibration of 1 px, subsets of 25 px can lose so many points that a pair has no complete gauge; its repetitions are left out.
    """
    found = [[_mean_squares(one) for one in pairs] for pairs in maps]
    return _largest(np.array([pairs for pairs in found if np.isfinite(pairs).all()]))


def _mean_squares(found: DisparityMap) -> list[float]:
    """Mean squares of exx, eyy and exy of complete gauges; not a number without one."""
    half = GAUGE_POINTS // 2
    inner = np.s_[half:-half, half:-half]
    moved = Displacement(0, found.grid, found.u_px, found.v_px, found.sigma_u_px, found.sigma_v_px, found.valid)
    field = mechanics.strain(moved, GAUGE_POINTS)
    complete = field.valid[inner]
    return [float(np.mean(value[inner][complete] ** 2)) if complete.any() else np.nan for value in (field.exx, field.eyy, field.exy)]


def gauge_step_px(subset_px: int) -> int:
    """Distance of the points with which gauges have the reference length."""
    return max((GAUGE_PX - subset_px) // (GAUGE_POINTS - 1), 2)
