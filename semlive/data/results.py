"""What the pipeline gives back for one pair, and for a whole run."""

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
    """What one pair changed.

    Attributes:
        decision: the pair.
        pairs: how many pairs the estimate is of.
        maps: what DIC measured: within the pair, and from frame 0 to each of its frames; empty if the pair was reported before.
        estimate: what the estimator knows after this pair; in a long run, between two choices, of the newest pairs.
        frames: the pair's two frames, corrected; none if the pair was reported before.
        elastic: elastic constants so far, or None.
        gage: DIC beside the strain gage so far, or None.
        revised_frames: earlier frames, corrected again because what is known now moved their mean strain by more than its uncertainty.
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
    """A whole run, every frame corrected with the newest estimate.

    Attributes:
        decisions: the pairs.
        estimate: the newest estimate.
        frames: every accepted frame, frame 0 first; those of a long run may have been handed over one by one and left out here.
        elastic: elastic constants, or None without loads or area.
        messages: sentences for the operator.
        gage: DIC beside the strain gage, or None without one.
        summaries: mean strain of every accepted frame, frame 0 first, whether or not its fields are kept in `frames`.
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
            object.__setattr__(self, "summaries", tuple(one.summary for one in self.frames))
