"""True noise of a simulated microscope: that of further frames without drift, distortion and moves, at the shifts of the real pairs.

Its uncertainty is stated, because the number of these frames is limited.
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
"""Begin of the further frames, after those of the run."""


@dataclass(frozen=True, slots=True)
class Truth:
    """A true value with its standard uncertainty, which is 0 if it is known exactly."""

    value: float
    sigma: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """Pairs of a microscope without drift, distortion and moves.

    Attributes:
        images: first and second frame of each pair.
    """

    images: tuple[tuple[NDArray[np.unsignedinteger], NDArray[np.unsignedinteger]], ...]

    @classmethod
    def of(cls, scenario: Scenario, shots: Sequence[ScannedFrame], raster: Raster, *, row_effects: bool) -> Still:
        """Render one pair for each pair of a run, with its shift within the pair and other noise."""
        chosen = tuple(member for member in scenario.effects.members if row_effects and isinstance(member, ROW_EFFECTS))
        still = replace(
            scenario, drift=Drift(STILL_AXIS, STILL_AXIS), distortion=Distortion(FLAT_AXIS, FLAT_AXIS), effects=EffectSet(chosen)
        )
        column, images = still.column(), []
        for pair in range(len(shots) // 2):
            ends = shots[2 * pair : 2 * pair + 2]
            moved = raster.rate_px_s(shots, pair) * (ends[1].start_s - ends[0].start_s)
            stop = np.array(ends[0].stop.shift_px)
            both = [
                render_frame(still, LATER_S + end.start_s, at_rest(stop + at * moved), len(shots) + end.frame, column)
                for at, end in enumerate(ends)
            ]
            images.append((both[0], both[1]))
        return cls(tuple(images))

    def maps(self, subset_px: int, step_px: int) -> list[DisparityMap]:
        """Maps of all pairs."""
        settings = dic.DicSettings(subset_px=subset_px, step_px=step_px, roi_px=None, method="subset")
        height, width = self.images[0][0].shape
        grid = dic.grid_for(settings, width, height)
        return [
            dic.correlate(dic.prepare(first, grid, settings), second, settings, reference_frame=0, current_frame=1)
            for first, second in self.images
        ]


def _largest(variances: Array) -> Truth:
    """Root of the largest mean variance of the components, (pairs, components), with the uncertainty by the scatter of the pairs."""
    mean = variances.mean(axis=0)
    worst = int(np.argmax(mean))
    value = float(np.sqrt(mean[worst]))
    return Truth(value, float(np.std(variances[:, worst], ddof=1)) / np.sqrt(len(variances)) / (2.0 * value))


def displacement_noise(maps: Sequence[DisparityMap]) -> Truth:
    """Noise of a displacement of the noisier axis; the mean motion, which is removed, takes the share of one subset."""
    rows = [[_variance(found, values) for values in (found.u_px, found.v_px)] for found in maps]
    return _largest(np.array(rows, dtype=np.float64))


def _variance(found: DisparityMap, values: Array) -> float:
    independent = float(found.valid.sum()) * found.grid.step_px**2 / found.grid.subset_px**2
    return float(np.var(values[found.valid])) / (1.0 - 1.0 / independent)


def strain_noise(maps: Sequence[DisparityMap]) -> Truth:
    """Noise of the strain of the reference gauge, the noisiest of exx, eyy and exy.

    With vibration of 1 px, subsets of 25 px can lose so many points that a pair has no complete gauge; it is left out.
    """
    grid, rows, half = maps[0].grid, [], GAUGE_POINTS // 2
    inner = np.s_[half:-half, half:-half]
    for found in maps:
        moved = Displacement(0, grid, found.u_px, found.v_px, found.sigma_u_px, found.sigma_v_px, found.valid)
        field = mechanics.strain(moved, GAUGE_POINTS)
        complete = field.valid[inner]
        if complete.any():
            rows.append([np.mean(value[inner][complete] ** 2) for value in (field.exx, field.eyy, field.exy)])
    return _largest(np.array(rows, dtype=np.float64))


def gauge_step_px(subset_px: int) -> int:
    """Distance of the points with which gauges have the reference length."""
    return max((GAUGE_PX - subset_px) // (GAUGE_POINTS - 1), 2)
