"""A hidden experiment through the pipeline, pair by pair, as the daemon takes it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from blind.experiment import HiddenPair
from numexp.asrun import frame_info

from semlive import pipeline
from semlive.data.experiment import Step
from semlive.data.loading import FrameLoad
from semlive.data.pair import PairDecision
from semlive.data.results import PairResult
from semlive.data.settings import AnalysisSettings

UM_PER_PX = 1.25


def followed(pairs: Iterable[HiddenPair], settings: AnalysisSettings) -> Iterator[tuple[pipeline.AnalysisState, PairResult]]:
    """What is known after each pair."""
    started = None
    for one in pairs:
        decision = decided(one)
        started = started or pipeline.start_from_maps(settings, decision.first, one.maps[0].grid)
        started, result = pipeline.add_pair(started, decision, one.maps)
        yield started, result


def decided(one: HiddenPair) -> PairDecision:
    """The decision for a hidden pair."""
    pose = one.pose
    shift_um = (pose.commanded_px[0] * UM_PER_PX, pose.commanded_px[1] * UM_PER_PX)
    step = Step(pose.pair, pose.phase, shift_um, pose.commanded_px, pose.load_n or None)
    held = FrameLoad(pose.load_n, pose.load_n, pose.load_n, 0.0)
    return PairDecision(pose.pair, step, frame_info(2 * pose.pair), frame_info(2 * pose.pair + 1), (held, held))
