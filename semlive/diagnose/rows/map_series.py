"""Series of the maps within pairs for the search of waves: maps minus the estimate, without what is constant along rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.map_residuals import over_grid_px
from semlive.diagnose.baseline.observation import Observation
from semlive.estimate.joint.observations.design_columns import predicted
from semlive.estimate.joint.observations.state import MapObservations

Array = NDArray[np.float64]
MIN_POINTS = 200  # of a map
CLIP = 4.5


@dataclass(frozen=True, slots=True, eq=False)
class MapSeries:
    """Displacement of the second frame of a pair relative to the first, over rows and columns of points.

    Attributes:
        shift_px: (2, n, m) displacement along x and y without trends, px; zero without data.
        valid: (n, m) points with data.
        row_px: (n,) rows of the points, px.
        column_px: (m,) columns of the points, px.
        subset_px: edge of the subsets, px.
        trends: (n m, k) orthonormal smooth fields that slow changes within a frame cause.
        row_time_s: time from row to row, s.
        dwell_time_s: time from column to column, s.
    """

    shift_px: Array
    valid: NDArray[np.bool_]
    row_px: Array
    column_px: Array
    subset_px: float
    trends: Array
    row_time_s: float
    dwell_time_s: float

    def remaining(self, frequency_hz: Array | float) -> Array:
        """Fraction of the amplitude of a wave that remains in the mean over a subset."""
        rows = np.asarray(frequency_hz) * self.row_time_s
        along_y = np.sinc((rows - np.round(rows)) * self.subset_px)
        return np.abs(along_y * np.sinc(np.asarray(frequency_hz) * self.dwell_time_s * self.subset_px))

    def wave_columns(self, frequency_hz: float, extra_cycles: float = 0.0) -> Array:
        """(n m, 2) cosine and sine of a wave of 1 px of beam deflection, without the same trends as the data.

        Args:
            frequency_hz: frequency, Hz.
            extra_cycles: cycles over the columns in addition to those of a wave of this frequency.
        """
        rows, columns = frequency_hz * self.row_time_s, frequency_hz * self.dwell_time_s + extra_cycles / float(np.ptp(self.column_px))
        phase = 2.0 * np.pi * ((rows - round(rows)) * self.row_px[:, None] + columns * self.column_px)
        waves = np.stack([np.cos(phase), np.sin(phase)]) * float(self.remaining(frequency_hz))
        return np.stack([_without_trends(wave, self.valid, self.trends).ravel() for wave in waves], axis=-1)

    def amplitude(self, frequency_hz: float, extra_cycles: float = 0.0) -> tuple[Array, float]:
        """(2, 2) least-squares cosine and sine amplitude along x and y, px, and the gain in the sum of squares, px^2."""
        columns = self.wave_columns(frequency_hz, extra_cycles)
        normal, right = columns.T @ columns, columns.T @ self.shift_px.reshape(2, -1).T
        solved = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(2), right)
        return solved.T, float(np.sum(solved * right))


def map_series(observation: Observation) -> tuple[MapSeries, ...]:
    """For each pair the difference of the maps from frame 0 to its frames, minus the estimate; the noise of frame 0 cancels.

    Pairs with too few points or rows of another duration are left out. Where the map to the second frame is composed of that to the first
    and the pair's own map, the latter is used: interpolation reduces its noise by an amount that depends on the fraction of the grid
    distance, and 3 of 100 runs of such maps without an effect were named a vibration.
    """
    grid, found = observation.grid, list[MapSeries]()
    to_frame = {rows.current: rows for rows in observation.rows}
    own = {rows.current: rows for rows in observation.state.rows if rows.within_pair and rows.reference}
    for step in observation.steps:
        frames = [frame for frame in (2 * step.pair + 1, 2 * step.pair) if frame]
        maps = [to_frame[frame] for frame in frames]
        composed = maps[0].dmap.intermediate is not None and frames[0] in own
        valid = own[frames[0]].dmap.valid if composed else np.all([rows.dmap.valid for rows in maps], axis=0)
        if int(valid.sum()) < MIN_POINTS:
            continue
        if composed:
            residual = _own_residual_px(observation, own[frames[0]], maps)
        else:
            residuals = [_residual_px(observation, rows) for rows in maps]
            residual = residuals[0] - residuals[1] if len(maps) > 1 else residuals[0]
        values = [np.where(valid, component, 0.0) for component in residual]
        timing = observation.state.frame_time(frames[0]).timing
        times_s = timing.row_time_s.value, timing.dwell_time_s.value
        if not found or times_s == (found[0].row_time_s, found[0].dwell_time_s):
            found.append(make_map_series(values, valid, (grid.y_px, grid.x_px), float(grid.subset_px), times_s))
    return tuple(found)


def _residual_px(observation: Observation, rows: MapObservations) -> Array:
    """(2, n, m) map minus the estimate along x and along y, px; not finite where the map is not valid."""
    used = observation.valid_blocks
    estimate_px = predicted(observation.state, rows, observation.solution.mean)[used]
    return np.stack((rows.dmap.u_px, rows.dmap.v_px)) - over_grid_px(observation, rows.position_px[used], estimate_px)


def _own_residual_px(observation: Observation, own: MapObservations, maps: Sequence[MapObservations]) -> Array:
    """(2, n, m) a pair's own map minus the estimate: the difference of those from frame 0, at the positions in the first frame, px."""
    used, mean = observation.valid_blocks, observation.solution.mean
    second_px, first_px = (predicted(observation.state, rows, mean)[used] for rows in maps)
    return np.stack((own.dmap.u_px, own.dmap.v_px)) - over_grid_px(observation, maps[1].position_px[used] + first_px, second_px - first_px)


def make_map_series(
    values_px: Sequence[NDArray[Any]], valid: NDArray[np.bool_], at_px: tuple[Array, Array], subset_px: float, times_s: tuple[float, float]
) -> MapSeries:
    """Series of one map.

    Args:
        values_px: displacement (n, m) along x and along y, px.
        valid: (n, m) points with data.
        at_px: (n,) rows and (m,) columns of the points, px.
        subset_px: edge of the subsets, px.
        times_s: row time and dwell time, s.
    """
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, len(one)) for one in at_px), indexing="ij")
    trends = np.linalg.qr(np.stack([_centred(one, valid).ravel() for one in (x, x * y, x * y**2, x**2, x**2 * y)], axis=-1))[0]
    shift = []
    for value in values_px:
        plain = _without_trends(np.where(valid, value, 0.0).astype(np.float64), valid, trends)
        limit = CLIP * 1.4826 * float(np.median(np.abs(plain[valid])))
        shift.append(_without_trends(np.clip(plain, -limit, limit), valid, trends))
    rows, columns = (one.astype(np.float64) for one in at_px)
    return MapSeries(np.stack(shift), valid, rows, columns, subset_px, trends, *times_s)


def wave_fields(observation: Observation, frequency_hz: float) -> Array:
    """(f, b, 2, 4 f) cosine and sine along x and along y of a wave with its own phase in every frame, in the blocks."""
    scene = observation.geometry
    f, b = scene.time_s.shape
    phase = 2.0 * np.pi * frequency_hz * scene.time_in_frame_s
    fields = np.zeros((f, b, 2, f, 4))
    for frame in range(f):
        for axis in (0, 1):
            fields[frame, :, axis, frame, 2 * axis], fields[frame, :, axis, frame, 2 * axis + 1] = (
                np.cos(phase[frame]),
                np.sin(phase[frame]),
            )
    return fields.reshape(f, b, 2, 4 * f)


def _centred(value: Array, valid: NDArray[np.bool_]) -> Array:
    """(n, m) values minus the mean of each row over the valid points; zero elsewhere."""
    count = np.maximum(valid.sum(axis=1, keepdims=True), 1)
    return np.where(valid, value - np.sum(np.where(valid, value, 0.0), axis=1, keepdims=True) / count, 0.0)


def _without_trends(value: Array, valid: NDArray[np.bool_], trends: Array) -> Array:
    """(n, m) values minus the mean of each row and the trends (n m, k)."""
    centred = _centred(value, valid)
    return np.where(valid, centred - (trends @ (trends.T @ centred.ravel())).reshape(centred.shape), 0.0)
