"""Start-time errors: scans that began earlier or later than reported, so the drift at the scan differs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.model.effect import Axis, Columns, FrameObservation

Rate = tuple[float, float]
ZERO_RATE: Rate = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class StartTimeErrors:
    """Delay of the second frame of a pair relative to its reported start, s. The frame shows an additional ``drift rate * delay``.

    A delay common to both frames of a pair is equivalent to their motion and is not modelled.

    Attributes:
        pairs: numbers of the pairs with uncertain starts, in order of arrival.
        sigma_s: standard uncertainty of each delay, s.
        rate_px_s: drift rate along x and y in the middle of the second frame of each pair, px/s, used for linearisation.
    """

    pairs: tuple[int, ...] = ()
    sigma_s: tuple[float, ...] = ()
    rate_px_s: tuple[Rate, ...] = ()

    @property
    def name(self) -> str:
        """``start_time``."""
        return "start_time"

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.pairs)

    @property
    def needs_ideal(self) -> bool:
        """True: the columns hold the drift's rate, which is itself estimated, as the ideal position is."""
        return True

    def with_pairs(self, pair: int, sigma_s: float) -> StartTimeErrors:
        """With one more pair; unchanged if its starts are known exactly."""
        if not sigma_s > 0:
            return self
        return StartTimeErrors((*self.pairs, pair), (*self.sigma_s, sigma_s), (*self.rate_px_s, ZERO_RATE))

    def only(self, pairs: set[int]) -> StartTimeErrors:
        """Restricted to some pairs."""
        at = [number for number, pair in enumerate(self.pairs) if pair in pairs]
        selected = (
            tuple(self.pairs[index] for index in at),
            tuple(self.sigma_s[index] for index in at),
            tuple(self.rate_px_s[index] for index in at),
        )
        return StartTimeErrors(*selected)

    def about(self, rates: dict[int, Rate]) -> StartTimeErrors:
        """Linearised about drift rates given by pair; other pairs keep their rates."""
        rate_by_pair = zip(self.pairs, self.rate_px_s, strict=True)
        return replace(self, rate_px_s=tuple(rates.get(pair, before) for pair, before in rate_by_pair))

    def part(self, pair: int) -> slice:
        """Index range of the parameter of a pair; empty if its starts are known exactly."""
        if pair not in self.pairs:
            return slice(0, 0)
        at = self.pairs.index(pair)
        return slice(at, at + 1)

    def columns(self, observation: FrameObservation) -> tuple[Columns, ...]:
        """Columns of the second frame of a pair, the same for all its points; none else.

        Over a frame the rate changes by some hundredths, and the error of a start is some hundredths of the time between frames.
        """
        if observation.frame % 2 == 0 or observation.pair not in self.pairs:
            return ()
        at = self.pairs.index(observation.pair)
        index = np.full((len(observation.x_px), 1), at, dtype=np.int64)
        rate = zip((Axis.X, Axis.Y), self.rate_px_s[at], strict=True)
        return tuple(Columns(axis, index, np.full((len(observation.x_px), 1), value)) for axis, value in rate)

    def late_px(self, frame: int, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """(2,) additional drift of a frame due to its start delay, px."""
        if frame % 2 == 0 or frame // 2 not in self.pairs:
            return np.zeros(2)
        at = self.pairs.index(frame // 2)
        return float(parameters[at]) * np.array(self.rate_px_s[at])
