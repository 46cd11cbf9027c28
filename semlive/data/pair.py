"""Pairs: two frames of one step, without motion between them."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.experiment import Step
from semlive.data.frame import Frame, FrameInfo
from semlive.data.loading import FrameLoad


@dataclass(frozen=True, slots=True)
class PairDecision:
    """Decision of the engine that two exported frames are the pair of a step.

    Frames are numbered 2 * pair and 2 * pair + 1; exported files have separate numbers, because most are not part of a pair.

    Attributes:
        pair: number of the pair, that of its step.
        step: commanded step.
        first: metadata of the first frame.
        second: metadata of the second frame.
        loads: load during the first and second frame, or None without a load frame.
    """

    pair: int
    step: Step
    first: FrameInfo
    second: FrameInfo
    loads: tuple[FrameLoad, FrameLoad] | None


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """A pair with its pixels."""

    decision: PairDecision
    first: Frame
    second: Frame
