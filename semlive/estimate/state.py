"""What the estimator has accumulated: block means of every map, and the information that they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.errors import IllPosed
from semlive.estimate.blocks import BlockColumns, Blocks
from semlive.model import DistortionSpline, DriftSpline, Effect, Layout, PairMotions


@dataclass(frozen=True, slots=True, eq=False)
class MapRows:
    """One disparity map as rows of the joint least squares: ``disparity = (columns at current) - (columns at reference)``.

    Attributes:
        reference: number of the reference frame.
        current: number of the current frame.
        disparity_px: (blocks, 2) block means.
        weight: (blocks, 2) one over the assigned variance, 1/px^2.
        share: rank of the noise of the pair's maps over their number: 2/3 for each of three maps among three frames.
        difference: columns of the effects that act at the scan address.
        position_px: (blocks, 2) mean address in the reference frame, relative to the image centre.
        at_reference: columns at the reference frame, which give the ideal position; empty within a pair.
    """

    reference: int
    current: int
    disparity_px: NDArray[np.float64]
    weight: NDArray[np.float64]
    share: float
    difference: tuple[BlockColumns, ...]
    position_px: NDArray[np.float64]
    at_reference: tuple[BlockColumns, ...]

    @property
    def within_pair(self) -> bool:
        """Whether nothing moved between the two frames."""
        return self.reference // 2 == self.current // 2


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorState:
    """Everything accumulated so far; `update` returns a new one.

    Attributes:
        settings: settings of the estimate.
        grid: POI in each map's reference frame.
        width_px: image width.
        height_px: image height.
        blocks: partition of the grid.
        distortion: the distortion effect.
        drift: the drift effect, lengthened as time goes on; None before the first pair.
        motions: the motion effect, one pair more with each update.
        frames: times of all frames in order of arrival.
        phases: phase of each pair in order of arrival.
        rows: block means of all maps, kept for re-linearisation and re-weighting.
        about: parameters about which the information is linearised; empty means zero.
        precision: (n, n) accumulated information matrix A^T W A at unit noise scale, without priors.
        information: (n,) accumulated information vector A^T W y.
    """

    settings: EstimateSettings
    grid: Grid
    width_px: int
    height_px: int
    blocks: Blocks
    distortion: DistortionSpline
    drift: DriftSpline | None
    motions: PairMotions
    frames: tuple[FrameTime, ...]
    phases: tuple[Phase, ...]
    rows: tuple[MapRows, ...]
    about: NDArray[np.float64]
    precision: NDArray[np.float64]
    information: NDArray[np.float64]

    @property
    def model(self) -> tuple[Effect, ...]:
        """The named effects."""
        return (self.distortion, self.drift, self.motions) if self.drift is not None else (self.distortion, self.motions)

    @property
    def layout(self) -> Layout:
        """Where each effect's parameters lie."""
        return Layout.of(self.model)

    @property
    def centre_px(self) -> NDArray[np.float64]:
        """(2,) the image centre, about which gradients act."""
        return 0.5 * np.array([self.width_px - 1.0, self.height_px - 1.0])

    def frame_time(self, frame: int) -> FrameTime:
        """When a frame was scanned; IllPosed if it never came."""
        for when in self.frames:
            if when.frame == frame:
                return when
        raise IllPosed(f"frame {frame} is not in the estimate, so its drift is unknown: add its pair first")


def init(settings: EstimateSettings, grid: Grid, width_px: int, height_px: int) -> EstimatorState:
    """An estimator that has seen nothing.

    Args:
        settings: knots of drift and distortion.
        grid: POI of every map to come.
        width_px: image width without databar.
        height_px: image height without databar.

    Raises:
        IllPosed: the grid is too small for a gradient.
    """
    if grid.nx < 3 or grid.ny < 3:
        raise IllPosed(f"a grid of {grid.nx} x {grid.ny} points cannot carry a strain: give at least 3 x 3 points")
    distortion = DistortionSpline.covering(width_px, height_px, settings.distortion_knot_px)
    n = distortion.size
    nothing = np.zeros(0)
    return EstimatorState(
        settings=settings,
        grid=grid,
        width_px=width_px,
        height_px=height_px,
        blocks=Blocks.of(grid),
        distortion=distortion,
        drift=None,
        motions=PairMotions(),
        frames=(),
        phases=(),
        rows=(),
        about=nothing,
        precision=np.zeros((n, n)),
        information=np.zeros(n),
    )
