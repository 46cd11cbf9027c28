"""The methods of estimation by name: modules with the same doors, each with a state and a solution of its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from semlive import estimate as joint
from semlive.data.disparity import DisparityMap
from semlive.data.drift import Correction, EstimateRevision, FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.data.storage import Storage
from semlive.data.strain import Tensor2
from semlive.estimate import sutton

PointSigma = tuple[NDArray[np.float64], NDArray[np.float64]]
"""(ny, nx) along x and along y."""


class Estimator(Protocol):
    """From maps to a solution. A state goes back only to the method that it came from."""

    def init(self, settings: EstimateSettings, grid: Grid, width_px: int, height_px: int) -> Any:
        """A state that has seen nothing."""
        ...

    def update(self, state: Any, pair: int, phase: Phase, times: tuple[FrameTime, FrameTime], maps: tuple[DisparityMap, ...]) -> Any:
        """The state with one pair more."""
        ...

    def offload(self, state: Any, pair: int, storage: Storage) -> Any:
        """The state with the large arrays of a pair, and those that are made of it later, kept by somebody else: the same numbers."""
        ...

    def solve(self, state: Any) -> Any:
        """The solution, with its `noise_floor_px`; everything that the data choose is chosen anew."""
        ...

    def solve_incremental(self, state: Any, previous: Any) -> Any:
        """The solution after a further pair, given that of an earlier one or None."""
        ...

    def solve_live(self, state: Any, previous: Any) -> Any:
        """What is wanted at once: with the choices that were made before, and of the newest pairs alone, if that costs less."""
        ...


class ResultExtractor(Protocol):
    """From a solution to what is said of it."""

    def to_estimate(self, solution: Any, revision: int, newest_only: bool = False) -> EstimateRevision:
        """Everything known; if so asked, of the newest pairs alone."""
        ...

    def consistency_messages(self, solution: Any) -> tuple[str, ...]:
        """Whether the estimate agrees with itself, one sentence each; costly, so not after every pair."""
        ...

    def correction(self, solution: Any, dmap: DisparityMap) -> Correction:
        """Drift and distortion in a map from frame 0."""
        ...

    def correction_sigmas(self, solution: Any, maps: Iterable[DisparityMap]) -> Iterable[PointSigma | None]:
        """Standard uncertainty (ny, nx) along x and y of each map's correction; None from a method that does not say."""
        ...

    def correction_strains(self, solution: Any, maps: Iterable[DisparityMap]) -> Sequence[Any]:
        """What the correction gives to each map's mean strain, with its uncertainty `sigma`, to be asked later how far it moved."""
        ...

    def strain_change(self, solution: Any, previous: Any) -> Tensor2:
        """How far a mean strain moves if it is corrected with this solution instead of the one that was told of."""
        ...

    def mean_strain_covariance(self, solution: Any, frames: Sequence[int], of: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """(2 n, 2 n) covariance of the mean strains of n frames, first all exx, then all eyy; or (k, k) of functions (k, 2 n) `of` them."""
        ...


class Method(Estimator, ResultExtractor, Protocol):
    """Maps in, estimate and corrections out."""


METHODS: dict[str, Method] = {"joint": joint, "sutton2007": sutton}
