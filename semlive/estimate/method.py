"""Estimation methods by name: modules with a common interface, each with its own types of state and solution."""

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
from semlive.data.notes import Note
from semlive.data.settings import EstimateSettings
from semlive.data.strain import Tensor2
from semlive.estimate import sutton
from semlive.estimate.storage import Storage
from semlive.estimate.sutton.results import CorrectionStrain as SuttonCorrectionStrain

MethodState = joint.EstimatorState | sutton.SuttonState
"""State of any method."""
MethodSolution = joint.Solution | sutton.SuttonSolution
"""Solution of any method."""
MethodCorrectionStrain = joint.CorrectionStrain | SuttonCorrectionStrain
"""Mean strain of a correction, of any method."""

PointSigma = tuple[NDArray[np.float64], NDArray[np.float64]]
"""(ny, nx) along x and along y."""


class Estimator(Protocol):
    """Computes a solution from maps. A state is valid only for the method that created it.

    Results are of the closed unions. Arguments are `Any`, because a method accepts only its own member of a union.
    """

    def init(self, settings: EstimateSettings, grid: Grid, width_px: int, height_px: int) -> MethodState:
        """A state without data."""
        ...

    def update(
        self, state: Any, pair: int, phase: Phase, times: tuple[FrameTime, FrameTime], maps: tuple[DisparityMap, ...]
    ) -> MethodState:
        """The state with one more pair."""
        ...

    def offload(self, state: Any, pair: int, storage: Storage) -> MethodState:
        """The state with the large arrays of a pair, and arrays derived from them later, moved to a storage. The values do not change."""
        ...

    def solve(self, state: Any) -> MethodSolution:
        """The solution with its `noise_floor_px`; all hyperparameters are selected again."""
        ...

    def solve_incremental(self, state: Any, previous: Any) -> MethodSolution:
        """The solution after a further pair, from the previous solution or None."""
        ...

    def solve_live(self, state: Any, previous: Any) -> MethodSolution:
        """The solution with the previous hyperparameters, restricted to the newest pairs if that is faster."""
        ...


class ResultExtractor(Protocol):
    """Derives results from a solution."""

    def to_estimate(self, solution: Any, revision: int, newest_only: bool = False) -> EstimateRevision:
        """The complete estimate; with `newest_only`, restricted to the newest pairs."""
        ...

    def consistency_notes(self, solution: Any) -> tuple[Note, ...]:
        """Results of consistency checks. Expensive, so not computed after every pair."""
        ...

    def correction(self, solution: Any, dmap: DisparityMap) -> Correction:
        """Drift and distortion in a map from frame 0."""
        ...

    def correction_sigmas(self, solution: Any, maps: Iterable[DisparityMap]) -> Iterable[PointSigma | None]:
        """Standard uncertainty (ny, nx) along x and y of the correction of each map; None if the method does not provide it."""
        ...

    def correction_strains(self, solution: Any, maps: Iterable[DisparityMap]) -> Sequence[MethodCorrectionStrain]:
        """Contribution of the correction to the mean strain of each map, with its uncertainty `sigma`, as input of `strain_change`."""
        ...

    def strain_change(self, solution: Any, previous: Any) -> Tensor2:
        """Change of a mean strain if the map is corrected with this solution instead of the previous one."""
        ...

    def mean_strain_covariance(self, solution: Any, frames: Sequence[int], of: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """(2 n, 2 n) covariance of the mean strains of n frames, first all exx, then all eyy; (k, k) of the functions `of` (k, 2 n)."""
        ...


class Method(Estimator, ResultExtractor, Protocol):
    """Maps in, estimate and corrections out."""


METHODS: dict[str, Method] = {"joint": joint, "sutton2007": sutton}
