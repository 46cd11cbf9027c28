"""The raster of a simulated microscope: its drift, distortion and settling in px of the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive import dic
from semlive.data.grid import Grid
from semlive.qualify.values import Qualification
from semlive_simulators.effects.interfaces import Effect, PixelOffsetEffect, PixelVisits
from semlive_simulators.effects.scan_deflection import MainsHum, RowJitter, Vibration
from semlive_simulators.effects.scan_timing import WrongRowTime
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.protocol_player import ScannedFrame
from semlive_simulators.specimen.specimen import at_rest

Array = NDArray[np.float64]
ROW_EFFECTS = (MainsHum, RowJitter, Vibration)
GAUGE_PX, HALF_SHIFT_PX = 83, 4.0
"""Gauge for which strain is stated, and half of the shift of which a false strain per px is the mean."""
POINTS, AFFINE_POINTS = 33, 13
"""Points along each axis at which false strain is evaluated, and at which the affine part of the distortion is removed, as stated."""
SUBSET_POINTS = 6
"""Points along each axis of a subset, over which the distortion is averaged."""


def effect_of(scenario: Scenario, *kinds: type[Effect]) -> Effect | None:
    """The effect of a kind; None without one."""
    return next((member for member in scenario.effects.members if isinstance(member, kinds)), None)


def row_time_error(scenario: Scenario) -> float:
    """True over stated row time, minus 1."""
    found = effect_of(scenario, WrongRowTime)
    return found.row_time_error if isinstance(found, WrongRowTime) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """The raster of a microscope over the measured part of the frame.

    Attributes:
        scenario: the microscope.
        grid: points of the measurement.
        turned: (2, 2) motion in the image per motion of the specimen along the axes of the column.
    """

    scenario: Scenario
    grid: Grid
    turned: Array

    @classmethod
    def of(cls, scenario: Scenario, found: Qualification) -> Raster:
        """The raster that was measured with the correlation of a qualification."""
        settings = dic.DicSettings(subset_px=found.protocol.subset_px, step_px=found.protocol.step_px, roi_px=None)
        grid = dic.grid_for(settings, scenario.scan.width_px, scenario.scan.height_px)
        plain = cls(scenario, grid, np.eye(2))
        mesh_x, mesh_y = _mesh(grid, 0.0, AFFINE_POINTS)
        columns = np.column_stack((np.ones(mesh_x.size), mesh_x, mesh_y))
        affine = np.linalg.lstsq(columns, bend_px(plain, mesh_x, mesh_y), rcond=None)[0][1:].T
        return replace(plain, turned=np.linalg.solve(np.eye(2) - affine, scenario.scan.rotation.T))

    def rate_px_s(self, shots: Sequence[ScannedFrame], pair: int) -> Array:
        """(2,) mean rate from the first frame of a pair to the second, px/s."""
        first, second = shots[2 * pair : 2 * pair + 2]
        row_s = self.scenario.scan.row_time_s * (1.0 + row_time_error(self.scenario))
        rows_s = row_s * self.grid.y_px
        moved = self.scenario.drift.at(second.start_s + rows_s) - self.scenario.drift.at(first.start_s + rows_s)
        return self.turned @ moved.mean(axis=0) / (second.start_s - first.start_s)


def bend_px(raster: Raster, x_px: Array, y_px: Array, *, settling_only: bool = False) -> Array:
    """(n, 2) distortion and settling at points (n,), mean over a subset, which is what a correlation measures."""
    offsets = (np.arange(SUBSET_POINTS) + 0.5 - 0.5 * SUBSET_POINTS) * raster.grid.subset_px / SUBSET_POINTS
    places = [(x_px + dx, y_px + dy) for dx in offsets for dy in offsets]
    return np.mean([_bend_px(raster.scenario, x, y, settling_only=settling_only) for x, y in places], axis=0)


def _bend_px(scenario: Scenario, x_px: Array, y_px: Array, *, settling_only: bool) -> Array:
    scan = scenario.scan
    total = np.zeros((len(x_px), 2)) if settling_only else scenario.distortion.at(x_px, y_px, scan.width_px, scan.height_px)
    for member in scenario.effects.members:
        if isinstance(member, PixelOffsetEffect) and not isinstance(member, ROW_EFFECTS):
            zero = np.zeros((len(y_px), 1))
            at = PixelVisits(
                x_px[:, None], y_px[:, None], x_px[:, None] * scan.dwell_time_s, 0.0, 0, 0, zero > 0.0, scan, at_rest(), (zero, zero)
            )
            total = total + np.stack([np.broadcast_to(part, (len(x_px), 1))[:, 0] for part in member.offset_px(at)], axis=-1)
    return total


def _mesh(grid: Grid, margin_px: float, points: int) -> tuple[Array, Array]:
    x = np.linspace(grid.x_px[0] + margin_px, grid.x_px[-1] - margin_px, points)
    y = np.linspace(grid.y_px[0] + margin_px, grid.y_px[-1] - margin_px, points)
    mesh_x, mesh_y = np.meshgrid(x, y)
    return mesh_x.ravel(), mesh_y.ravel()


def largest_distortion_px(raster: Raster) -> float:
    """Largest distortion without its affine part."""
    x, y = _mesh(raster.grid, 0.0, AFFINE_POINTS)
    values = bend_px(raster, x, y)
    columns = np.column_stack((np.ones(len(x)), x, y))
    return float(np.linalg.norm(values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0], axis=1).max())


def false_strain_per_px(raster: Raster, *, settling_only: bool = False) -> float:
    """Largest false strain of a gauge per px of shift, over exx, eyy, exy, shifts along both axes, and places."""
    x, y = _mesh(raster.grid, 0.5 * GAUGE_PX + HALF_SHIFT_PX, POINTS)
    half, largest = 0.5 * GAUGE_PX, 0.0
    for shift in np.eye(2) * HALF_SHIFT_PX:

        def change(dx: float, dy: float, shift: Array = shift) -> Array:
            ends = [bend_px(raster, x + dx + s * shift[0], y + dy + s * shift[1], settling_only=settling_only) for s in (1, -1)]
            return (ends[0] - ends[1]) / (2.0 * HALF_SHIFT_PX)

        by_x, by_y = (change(half, 0.0) - change(-half, 0.0)) / GAUGE_PX, (change(0.0, half) - change(0.0, -half)) / GAUGE_PX
        for strain in (by_x[:, 0], by_y[:, 1], 0.5 * (by_y[:, 0] + by_x[:, 1])):
            largest = max(largest, float(np.abs(strain).max()))
    return largest
