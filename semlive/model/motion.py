"""Motion of the specimen: one per pair, translation with either a small rotation or a free gradient."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from semlive.model.effect import Axis, Columns, FrameObservation


class MotionKind(Enum):
    """Motion of the specimen relative to pair 0 in addition to translation."""

    RIGID = 3
    """A small rotation: parameters shift x, shift y, angle (rad, positive from x towards y)."""
    GRADIENT = 6
    """A free displacement gradient: parameters shift x, du/dx, du/dy, shift y, dv/dx, dv/dy."""


@dataclass(frozen=True, slots=True)
class PairMotions:
    """shift + G (p_0 - c), with parameters for every pair but the reference, pair 0.

    Attributes:
        pairs: numbers of the pairs, in order of arrival, pair 0 excluded.
        kinds: what each may do.
    """

    pairs: tuple[int, ...] = ()
    kinds: tuple[MotionKind, ...] = ()

    @property
    def name(self) -> str:
        """``motion``."""
        return "motion"

    @property
    def size(self) -> int:
        """Number of parameters."""
        return _count(self.kinds)

    @property
    def needs_ideal(self) -> bool:
        """True: the gradient multiplies the ideal position."""
        return True

    def part(self, pair: int) -> tuple[slice, MotionKind]:
        """Index range and kind of the parameters of one pair."""
        at = self.pairs.index(pair)
        start = _count(self.kinds[:at])
        return slice(start, start + self.kinds[at].value), self.kinds[at]

    def with_pair(self, pair: int, kind: MotionKind) -> PairMotions:
        """The motion with one more pair."""
        return PairMotions((*self.pairs, pair), (*self.kinds, kind))

    def columns(self, observation: FrameObservation) -> tuple[Columns, ...]:
        """Columns of the pair of the observation; none for the reference pair."""
        if observation.pair not in self.pairs:
            return ()
        if observation.ideal_px is None:
            raise ValueError("the motion's columns need the ideal position of the points")
        part, kind = self.part(observation.pair)
        ones, (px, py) = np.ones(len(observation.ideal_px)), observation.ideal_px.T
        if kind is MotionKind.RIGID:
            return _column(Axis.X, part.start, (0, 2), (ones, -py)), _column(Axis.Y, part.start, (1, 2), (ones, px))
        return _column(Axis.X, part.start, (0, 1, 2), (ones, px, py)), _column(Axis.Y, part.start, (3, 4, 5), (ones, px, py))

    def turn_rad(self, pair: int, parameters: NDArray[np.float64]) -> float:
        """Rotation of a pair with rigid motion, rad; else 0."""
        if pair not in self.pairs:
            return 0.0
        part, kind = self.part(pair)
        return float(parameters[part][2]) if kind is MotionKind.RIGID else 0.0

    def shift_and_gradient(self, pair: int, parameters: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(2,) shift and (2, 2) gradient of one pair; zero for the reference pair."""
        if pair not in self.pairs:
            return np.zeros(2), np.zeros((2, 2))
        part, kind = self.part(pair)
        value = parameters[part]
        if kind is MotionKind.RIGID:
            return value[:2].copy(), np.array([[0.0, -value[2]], [value[2], 0.0]])
        return value[[0, 3]], value[[1, 2, 4, 5]].reshape(2, 2)


def _count(kinds: tuple[MotionKind, ...]) -> int:
    """Number of parameters of the given pairs; called many times per pair, so it counts without a loop."""
    rigid = MotionKind.RIGID.value
    return rigid * len(kinds) + (MotionKind.GRADIENT.value - rigid) * kinds.count(MotionKind.GRADIENT)


def _column(axis: Axis, start: int, at: tuple[int, ...], values: tuple[NDArray[np.float64], ...]) -> Columns:
    value = np.stack(values, axis=1)
    index = np.broadcast_to(start + np.array(at, dtype=np.int64), value.shape)
    return Columns(axis, index, value)
