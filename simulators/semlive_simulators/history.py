"""What was done to the specimen before an instant: load steps and moves."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LoadStep:
    """A load that was reached.

    Attributes:
        time_s: when, seconds since the run began.
        change_n: since the step before.
    """

    time_s: float
    change_n: float


@dataclass(frozen=True, slots=True)
class Move:
    """A move of the stage that ended.

    Attributes:
        time_s: when, seconds since the run began.
        from_px: (x, y) commanded position before.
        to_px: (x, y) commanded position after.
    """

    time_s: float
    from_px: tuple[float, float]
    to_px: tuple[float, float]

    @property
    def change_px(self) -> tuple[float, float]:
        """The commanded motion."""
        return self.to_px[0] - self.from_px[0], self.to_px[1] - self.from_px[1]


@dataclass(frozen=True, slots=True)
class History:
    """Load steps and moves, each in order of time."""

    load_steps: tuple[LoadStep, ...] = ()
    moves: tuple[Move, ...] = ()

    def changes_s(self) -> list[float]:
        """Times of everything that happened, in order."""
        return sorted([step.time_s for step in self.load_steps] + [move.time_s for move in self.moves])


NOTHING_DONE = History()
"""The history of a specimen that was just put in."""
