"""State of an analysis: everything that the pairs so far have given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.settings import AnalysisSettings
from semlive.data.strain import ElasticConstants, StrainGageComparison, StrainSummary, Tensor2
from semlive.estimate.method import METHODS, Method, MethodCorrectionStrain, MethodSolution, MethodState
from semlive.estimate.storage import IN_MEMORY, Storage
from semlive.pipeline.effect_correction import EffectCorrection

NO_CORRECTION = EffectCorrection(0)
"""Correction of a run without an effect model."""

ElasticResult = tuple[ElasticConstants | None, StrainGageComparison | None]
"""Elastic constants and comparison with the strain gage; None where the data do not determine them."""


@dataclass(frozen=True, slots=True, eq=False)
class ReportedFrame:
    """Newest reported result of a frame.

    Attributes:
        summary: mean strain with its uncertainty.
        correction_strain: share of the correction in the mean strain, as the method states it; None for frame 0.
        model_strain: mean strain of the effect model that was subtracted from the frame's map.
    """

    summary: StrainSummary
    correction_strain: MethodCorrectionStrain | None
    model_strain: Tensor2


@dataclass(frozen=True, slots=True, eq=False)
class PrecorrelatedFrame:
    """Results for a frame that are computed before its pair is complete.

    Attributes:
        prepared_reference: the frame as reference of the next one; None if it is not expected to be a reference.
        from_frame_0: map from frame 0; None where the map depends on the complete pair.
    """

    prepared_reference: dic.Reference | None
    from_frame_0: DisparityMap | None


NOT_PRECORRELATED = PrecorrelatedFrame(None, None)
NO_PRECORRELATION: Mapping[int, PrecorrelatedFrame] = MappingProxyType({})


@dataclass(frozen=True, slots=True, eq=False)
class AnalysisState:
    """A run with its reference frame and the results of its pairs so far.

    Attributes:
        settings: of the analysis.
        grid: the POI, in frame 0.
        reference: frame 0 prepared for correlation; None where the disparity maps come from elsewhere.
        estimator_state: observations of drift, distortion and motion, in the form of the method that the settings name.
        pairs: the pairs so far.
        maps_from_reference: disparity from frame 0 to every later frame.
        solution: newest solution of the method; None before the first.
        reported: newest reported result by frame number; empty unless the run is followed pair by pair.
        elastic: newest reported elastic constants and comparison with the strain gage.
        storage: holds everything that grows with the pairs.
        loaded_pairs: positions in `pairs` of the pairs under load.
        revision: number of solutions so far.
        raw_maps: the pairs' maps as measured, where the settings have an effect model.
        model_correction: effect model subtracted from the maps in `estimator_state` and `maps_from_reference`.
    """

    settings: AnalysisSettings
    grid: Grid
    reference: dic.Reference | None
    estimator_state: MethodState
    pairs: Sequence[PairDecision]
    maps_from_reference: Sequence[DisparityMap]
    solution: MethodSolution | None = None
    reported: Mapping[int, ReportedFrame] = field(default_factory=dict)
    elastic: ElasticResult = (None, None)
    storage: Storage = IN_MEMORY
    loaded_pairs: tuple[int, ...] = ()
    revision: int = 0
    raw_maps: tuple[tuple[DisparityMap, ...], ...] = ()
    model_correction: EffectCorrection = NO_CORRECTION

    @property
    def method(self) -> Method:
        """The method of estimation."""
        return METHODS[self.settings.estimate.method]

    @property
    def tension_pairs(self) -> list[PairDecision]:
        """The pairs under load."""
        return [self.pairs[at] for at in self.loaded_pairs]


def frames_of(pair: PairDecision) -> tuple[int, int]:
    """Numbers of a pair's frames."""
    return 2 * pair.pair, 2 * pair.pair + 1
