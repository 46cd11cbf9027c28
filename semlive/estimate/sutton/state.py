"""Data of the published procedure: the disparity maps of every pair in order of arrival."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.errors import IllPosed
from semlive.estimate.storage import Storage


@dataclass(frozen=True, slots=True, eq=False)
class PairMaps:
    """Maps of one pair.

    Attributes:
        pair: number of the pair.
        phase: phase of the pair.
        times: scan times of its frames.
        maps: maps within the pair and from frame 0 to its frames; any of them may be missing.
    """

    pair: int
    phase: Phase
    times: tuple[FrameTime, FrameTime]
    maps: tuple[DisparityMap, ...]

    @property
    def within(self) -> DisparityMap | None:
        """The map within the pair."""
        return self._find(2 * self.pair, 2 * self.pair + 1)

    @property
    def from_reference(self) -> DisparityMap | None:
        """The map from frame 0 to the pair's first frame: an odd-numbered image in the paper's count from 1."""
        return self._find(0, 2 * self.pair) if self.pair else None

    @property
    def calibrates(self) -> bool:
        """Whether the specimen moved rigidly, so that the pair determines distortion."""
        return self.phase is Phase.CALIBRATION

    def _find(self, reference: int, current: int) -> DisparityMap | None:
        return next((dmap for dmap in self.maps if (dmap.reference, dmap.current) == (reference, current)), None)


@dataclass(frozen=True, slots=True, eq=False)
class SuttonState:
    """Everything given so far; `update` returns a new one.

    Attributes:
        settings: settings of the estimate.
        grid: POI in each map's reference frame.
        width_px: image width.
        height_px: image height.
        pairs: in order of arrival.
    """

    settings: EstimateSettings
    grid: Grid
    width_px: int
    height_px: int
    pairs: tuple[PairMaps, ...]

    def frame_time(self, frame: int) -> FrameTime:
        """Scan time of a frame. Raises IllPosed for a frame that was not added."""
        for when in self.frames:
            if when.frame == frame:
                return when
        raise IllPosed(f"frame {frame} is not in the estimate, so its drift is unknown: add its pair first")

    @property
    def frames(self) -> Iterator[FrameTime]:
        """Times of all frames in order of arrival."""
        return (when for pair in self.pairs for when in pair.times)


def init(settings: EstimateSettings, grid: Grid, width_px: int, height_px: int) -> SuttonState:
    """Return the state of an estimator without data.

    Raises:
        IllPosed: the grid is too small for a displacement gradient.
    """
    if grid.nx < 3 or grid.ny < 3:
        raise IllPosed(f"a grid of {grid.nx} x {grid.ny} points cannot carry a strain: give at least 3 x 3 points")
    return SuttonState(settings, grid, width_px, height_px, ())


def update(
    state: SuttonState, pair: int, phase: Phase, times: tuple[FrameTime, FrameTime], maps: tuple[DisparityMap, ...]
) -> SuttonState:  # fmt: skip
    """Add one pair. The procedure is a batch, so all computation is in `solve`.

    Raises:
        IllPosed: pair 0 is missing, pairs come out of order, or no point was correlated.
    """
    if not state.pairs and pair != 0:
        raise IllPosed(f"pair {pair} came before pair 0, the reference of all others: give pair 0 first")
    if state.pairs and times[0].start_s < state.pairs[-1].times[0].start_s:
        raise IllPosed(f"pair {pair} was scanned before a pair already known: give pairs in the order of their times")
    if not any(dmap.valid.any() for dmap in maps):
        raise IllPosed(f"no point of pair {pair} was correlated, so it has no information: check focus and contrast of its frames")
    for dmap in maps:
        if dmap.grid != state.grid:
            raise IllPosed(f"the map {dmap.reference} -> {dmap.current} is on another grid than the estimate: correlate all on one grid")
    return replace(state, pairs=(*state.pairs, PairMaps(pair, phase, times, maps)))


def offload(state: SuttonState, pair: int, storage: Storage) -> SuttonState:
    """Return the state unchanged; it holds only the maps, which the caller stores."""
    del pair, storage
    return state
