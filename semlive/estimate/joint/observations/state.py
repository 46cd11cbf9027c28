"""State of the estimator: block means of every map and the normal equations accumulated from them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.block_means import BlockColumns, Blocks, PackedColumns, StoredColumns, blocks_of
from semlive.estimate.storage import IN_MEMORY, Storage
from semlive.model import (
    DistortionSpline,
    DriftSpline,
    Effect,
    Layout,
    PairMotions,
    RasterChange,
    RowShiftEffect,
    ScanAxes,
    StartTimeErrors,
)

ManyColumns = tuple[BlockColumns | PackedColumns, ...] | StoredColumns
NO_ROW_SHIFTS, NO_START_TIME_ERRORS = RowShiftEffect(), StartTimeErrors()


@dataclass(frozen=True, slots=True, eq=False)
class MapObservations:
    """One disparity map as rows of the joint least squares: ``disparity = (columns at current) - (columns at reference)``.

    Attributes:
        reference: number of the reference frame.
        current: number of the current frame.
        disparity_px: (blocks, 2) block means.
        weight: (blocks, 2) one over the assigned variance, 1/px^2; zero where empty, or where other maps contain the same information.
        noisy_frames: number of frames whose noise the weight includes: 1 from frame 0, whose noise is estimated, 2 within a pair.
        difference_columns: columns of the effects that act at the scan address.
        position_px: (blocks, 2) mean address in the reference frame, relative to the image centre.
        reference_columns: columns at the reference frame, negative, which give the ideal position; empty within a pair.
        dmap: the map, from which columns are computed again.
    """

    reference: int
    current: int
    disparity_px: NDArray[np.float64]
    weight: NDArray[np.float64]
    noisy_frames: int
    difference_columns: ManyColumns
    position_px: NDArray[np.float64]
    reference_columns: ManyColumns
    dmap: DisparityMap

    @property
    def from_reference(self) -> bool:
        """Whether the map starts from frame 0."""
        return self.reference == 0

    @property
    def within_pair(self) -> bool:
        """Whether nothing moved between the two frames."""
        return self.reference // 2 == self.current // 2


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceNoise:
    """Noise of frame 0 in every block, shared by all maps from frame 0. The noise values are parameters and are marginalised in `solve`.

    Attributes:
        weight: (blocks, 2) information on each value, including its prior, 1/px^2.
        prior: (blocks, 2) part of the prior, 1/px^2.
        prior_frame: (blocks, 2) number of the frame from which the prior was derived.
        coupling: (2, blocks, n) information shared with the parameters, for x and y.
        information: (blocks, 2) information vector.
    """

    weight: NDArray[np.float64]
    prior: NDArray[np.float64]
    prior_frame: NDArray[np.int64]
    coupling: NDArray[np.float64]
    information: NDArray[np.float64]

    @classmethod
    def empty(cls, blocks: int, size: int) -> ReferenceNoise:
        """The state before the first map."""
        no_frame = np.full((blocks, 2), np.iinfo(np.int64).max)
        return cls(np.zeros((blocks, 2)), np.zeros((blocks, 2)), no_frame, np.zeros((2, blocks, size)), np.zeros((blocks, 2)))

    def copy(self) -> ReferenceNoise:
        """A copy with its own arrays."""
        return ReferenceNoise(self.weight.copy(), self.prior.copy(), self.prior_frame.copy(), self.coupling.copy(), self.information.copy())

    def mean_px(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """(blocks, 2) posterior mean of the noise given the parameters, px."""
        explained = np.stack([value @ parameters for value in self.coupling], axis=1)
        return (self.information - explained) / np.where(self.weight > 0, self.weight, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Extent:
    """Range of the scan addresses of all points.

    Attributes:
        lowest_px: (2,) smallest scan address along x and y, px.
        highest_px: (2,) largest scan address along x and y, px.
    """

    lowest_px: NDArray[np.float64]
    highest_px: NDArray[np.float64]

    def union(self, other: Extent) -> Extent:
        """Smallest extent that contains both."""
        return Extent(np.minimum(self.lowest_px, other.lowest_px), np.maximum(self.highest_px, other.highest_px))


@dataclass(frozen=True, eq=False)
class EstimatorState:
    """Everything accumulated so far; `update` returns a new one.

    Attributes:
        settings: settings of the estimate.
        grid: POI in each map's reference frame.
        width_px: image width.
        height_px: image height.
        blocks: partition of the grid.
        distortion: the distortion effect.
        drift: the drift effect, extended with each pair; None before the first pair.
        raster: changes of the raster in time, zero unless the data require them; empty before the first pair.
        axes: the axes of the scan.
        motions: the motion effect, extended by one pair with each update.
        frames: times of all frames in the order of their times.
        phases: phase of each pair in order of arrival.
        rows: block means of all maps, stored for re-linearisation and re-weighting.
        linearisation_point: parameters about which the information is linearised; empty means zero.
        precision: (n, n) accumulated information matrix A^T W A at unit noise scale, without priors; empty where it is not stored.
        information: (n,) accumulated information vector A^T W y; likewise.
        reference: information of the maps on the noise of frame 0.
        calibrated: range of the block centres in frames of calibration and translation pairs; None without such frames.
        row_shifts: shifts of rows; in no frame unless the data require them.
        start_time_errors: start-time errors of the pairs with uncertain start times.
        storage: storage of the data of single pairs, here and in values derived from them.
    """

    settings: EstimateSettings
    grid: Grid
    width_px: int
    height_px: int
    blocks: Blocks
    distortion: DistortionSpline
    drift: DriftSpline | None
    raster: tuple[RasterChange, ...]
    axes: ScanAxes
    motions: PairMotions
    frames: tuple[FrameTime, ...]
    phases: tuple[Phase, ...]
    rows: Sequence[MapObservations]
    linearisation_point: NDArray[np.float64]
    precision: NDArray[np.float64]
    information: NDArray[np.float64]
    reference: ReferenceNoise
    calibrated: Extent | None = None
    row_shifts: RowShiftEffect = NO_ROW_SHIFTS
    start_time_errors: StartTimeErrors = NO_START_TIME_ERRORS
    storage: Storage = IN_MEMORY

    @cached_property
    def model(self) -> tuple[Effect, ...]:
        """The effects of the model."""
        drift = () if self.drift is None else (self.drift,)
        return (self.distortion, *drift, *self.raster, self.row_shifts, self.start_time_errors, self.axes, self.motions)

    @cached_property
    def layout(self) -> Layout:
        """Index range of the parameters of each effect."""
        return Layout.of(self.model)

    @property
    def summed(self) -> bool:
        """Whether the state holds its sums: `precision`, `information` and the coupling to the noise of frame 0."""
        return len(self.information) > 0

    @property
    def centre_px(self) -> NDArray[np.float64]:
        """(2,) the image centre, px, the origin of the displacement gradients."""
        return 0.5 * np.array([self.width_px - 1.0, self.height_px - 1.0])

    def frame_time(self, frame: int) -> FrameTime:
        """Scan time of a frame. Raises IllPosed for a frame that was not added."""
        usual = self.frames[frame : frame + 1]  # where every pair came in its turn
        for when in (*usual, *(() if usual and usual[0].frame == frame else self.frames)):
            if when.frame == frame:
                return when
        raise IllPosed(f"frame {frame} is not in the estimate, so its drift is unknown: add its pair first")


def rows_of(state: EstimatorState, pairs: Collection[int]) -> list[MapObservations]:
    """Rows of the maps of some pairs in order of arrival. If every pair has all its maps, only the rows of these pairs are read."""
    found = []
    for place, pair in enumerate((0, *state.motions.pairs)):
        if pair in pairs:
            usual = state.rows[max(3 * place - 2, 0) : 3 * place + 1]
            if len(usual) != (3 if place else 1) or any(map_rows.current // 2 != pair for map_rows in usual):
                return [map_rows for map_rows in state.rows if map_rows.current // 2 in pairs]
            found += usual
    return found


def init(settings: EstimateSettings, grid: Grid, width_px: int, height_px: int) -> EstimatorState:
    """Return the state of an estimator without data.

    Args:
        settings: knot spacing of drift and distortion.
        grid: POI of all maps.
        width_px: image width without databar, px.
        height_px: image height without databar, px.

    Raises:
        IllPosed: the grid is too small for a displacement gradient.
    """
    if grid.nx < 3 or grid.ny < 3:
        raise IllPosed(f"a grid of {grid.nx} x {grid.ny} points cannot carry a strain: give at least 3 x 3 points")
    distortion = DistortionSpline.covering(width_px, height_px, settings.distortion_knot_px, grid.x0_px)
    n = distortion.size + ScanAxes().size
    blocks, nothing = blocks_of(grid, settings.max_blocks), np.zeros(0)
    return EstimatorState(
        settings=settings,
        grid=grid,
        width_px=width_px,
        height_px=height_px,
        blocks=blocks,
        distortion=distortion,
        drift=None,
        raster=(),
        axes=ScanAxes(),
        motions=PairMotions(),
        frames=(),
        phases=(),
        rows=(),
        linearisation_point=nothing,
        precision=np.zeros((n, n)),
        information=np.zeros(n),
        reference=ReferenceNoise.empty(blocks.size, n),
    )


def offload(state: EstimatorState, pair: int, storage: Storage) -> EstimatorState:
    """Return the state with the rows of the maps of a pair moved to a storage. The rows are nearly all that the state holds of a pair.

    Args:
        state: the state; `pair` is its latest pair.
        pair: number of the pair.
        storage: storage for the rows and for data derived from them later.
    """
    if state.storage is storage:
        return state  # already stored
    count = next((at for at, map_rows in enumerate(reversed(state.rows)) if map_rows.current // 2 != pair), len(state.rows))
    first = len(state.rows) - count
    return replace(
        state,
        rows=storage.append(state.rows[:first], (offload_rows(map_rows, storage) for map_rows in state.rows[first:])),
        storage=storage,
    )


def offload_rows(rows: MapObservations, storage: Storage) -> MapObservations:
    """Return the rows with their large arrays moved to `storage`."""
    if storage is IN_MEMORY:
        return rows
    # If frame 0 has all its points, its columns are shared by all maps; otherwise they are packed.
    own = not isinstance(rows.reference_columns, StoredColumns) and any(
        isinstance(reference_column, PackedColumns) for reference_column in rows.reference_columns
    )
    return replace(
        rows,
        disparity_px=storage.store_array(rows.disparity_px),
        weight=storage.store_array(rows.weight),
        position_px=storage.store_array(rows.position_px),
        difference_columns=_stored(rows.difference_columns, storage),
        reference_columns=_stored(rows.reference_columns, storage) if own else rows.reference_columns,
    )


def _stored(columns: ManyColumns, storage: Storage) -> StoredColumns:
    return columns if isinstance(columns, StoredColumns) else StoredColumns.of(columns, storage)
