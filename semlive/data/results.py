"""Results of the pipeline for one pair and for a complete run."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.disparity import DisparityMap
from semlive.data.drift import EstimateRevision
from semlive.data.pair import PairDecision
from semlive.data.strain import Displacement, ElasticConstants, StrainField, StrainGageComparison, StrainSummary


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """One corrected frame, relative to frame 0.

    Attributes:
        displacement: corrected for drift and distortion.
        strain: strain field of the configured virtual strain gauge.
        summary: mean, its uncertainty and standard deviation over the field.
    """

    displacement: Displacement
    strain: StrainField
    summary: StrainSummary


@dataclass(frozen=True, slots=True, eq=False)
class PairResult:
    """New and revised results after one pair.

    Attributes:
        decision: the pair.
        pairs: number of pairs in the estimate.
        maps: disparity maps within the pair and from frame 0 to each of its frames; empty if the pair was reported before.
        estimate: results of the estimator after this pair; in a long run, between two reviews, only of the newest pairs.
        frames: the two corrected frames of the pair; empty if the pair was reported before.
        elastic: elastic constants so far, or None.
        gage: comparison of DIC with the strain gage so far, or None.
        revised_frames: earlier frames, corrected again because their mean strain changed by more than its uncertainty.
    """

    decision: PairDecision
    pairs: int
    maps: tuple[DisparityMap, ...]
    estimate: EstimateRevision
    frames: tuple[FrameResult, ...]
    elastic: ElasticConstants | None
    gage: StrainGageComparison | None = None
    revised_frames: tuple[FrameResult, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """Results of a complete run, with every frame corrected by the newest estimate.

    Attributes:
        decisions: the pairs.
        estimate: the newest estimate.
        frames: every accepted frame, frame 0 first; empty where the frames of a long run were passed on one by one.
        elastic: elastic constants, or None without loads or area.
        messages: lines for the operator, made of the notes of the estimate and of the strain gage.
        gage: comparison of DIC with the strain gage, or None without a gage.
        summaries: mean strain of every accepted frame, frame 0 first, including frames that are not in `frames`.
    """

    decisions: tuple[PairDecision, ...]
    estimate: EstimateRevision
    frames: tuple[FrameResult, ...]
    elastic: ElasticConstants | None
    messages: tuple[str, ...]
    gage: StrainGageComparison | None = None
    summaries: tuple[StrainSummary, ...] = ()

    def __post_init__(self) -> None:
        if not self.summaries:
            object.__setattr__(self, "summaries", tuple(frame.summary for frame in self.frames))
