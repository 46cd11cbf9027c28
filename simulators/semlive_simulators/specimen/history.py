"""History of a specimen up to an instant: load steps, moves of the stage and beam shifts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LoadStep:
    """A completed load step.

    Attributes:
        time_s: end of the step, seconds since the run began.
        change_n: change of the load since the previous step, N.
    """

    time_s: float
    change_n: float


@dataclass(frozen=True, slots=True)
class Move:
    """A completed move of the stage, or a completed beam shift.

    Attributes:
        time_s: end of the move, seconds since the run began.
        from_px: (x, y) commanded position before.
        to_px: (x, y) commanded position after.
    """

    time_s: float
    from_px: tuple[float, float]
    to_px: tuple[float, float]

    @property
    def change_px(self) -> tuple[float, float]:
        """The commanded motion, (x, y) in px."""
        return self.to_px[0] - self.from_px[0], self.to_px[1] - self.from_px[1]


@dataclass(frozen=True, slots=True)
class History:
    """Completed steps and moves, each kind in the order of time.

    Beam shifts are separate from moves of the stage: a beam shift moves no gears, guides or piezos, so it causes no backlash, yaw,
    relaxation or other stage error. Effects of any new field of view, such as focusing again, depend on both.

    Attributes:
        load_steps: completed load steps.
        moves: completed moves of the stage.
        beam_shifts: completed beam shifts.
    """

    load_steps: tuple[LoadStep, ...] = ()
    moves: tuple[Move, ...] = ()
    beam_shifts: tuple[Move, ...] = ()

    def changes_s(self) -> list[float]:
        """Times of all completed steps and moves, in order."""
        return sorted(event.time_s for kind in (self.load_steps, self.moves, self.beam_shifts) for event in kind)


EMPTY_HISTORY = History()
"""The history of a new specimen."""
