"""What was done before an instant: load steps, moves of the stage and shifts of the beam."""

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
    """A move of the stage, or a shift of the beam, that ended.

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
    """What was done, each kind in order of time.

    Shifts of the beam are kept apart from moves of the stage: gears, guides and piezos do not move when coils do, so backlash, yaw,
    relaxation and the stage's own errors must not see them. What follows from any new place in view, such as focusing
    again, sees both.

    Attributes:
        load_steps: loads that were reached.
        moves: of the stage.
        beam_shifts: of the beam.
    """

    load_steps: tuple[LoadStep, ...] = ()
    moves: tuple[Move, ...] = ()
    beam_shifts: tuple[Move, ...] = ()

    def changes_s(self) -> list[float]:
        """Times of everything that happened, in order."""
        return sorted(done.time_s for kind in (self.load_steps, self.moves, self.beam_shifts) for done in kind)


EMPTY_HISTORY = History()
"""The history of a specimen that was just put in."""
