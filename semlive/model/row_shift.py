"""Row shift: displacement of groups of rows along x, different in every frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.model.effect import Axis, Columns, FrameObservation
from semlive.model.splines import UniformSpline


@dataclass(frozen=True, slots=True)
class RowShiftEffect:
    """Mean shift of row groups along x in frame n, l_n(y), linear between groups, with parameters for every frame.

    Single rows are not observable in maps, because a subset averages over its rows.

    Attributes:
        over_y: spline over the rows of a frame; None without row shifts.
        frames: numbers of the frames, in order of arrival.
    """

    over_y: UniformSpline | None = None
    frames: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """``line_shift``."""
        return "line_shift"

    @property
    def each(self) -> int:
        """Number of parameters of a frame."""
        return 0 if self.over_y is None else self.over_y.size

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.each * len(self.frames)

    @property
    def needs_ideal(self) -> bool:
        """False: it acts on the scan address."""
        return False

    def with_frames(self, frames: tuple[int, ...]) -> RowShiftEffect:
        """With further frames, if the model has row shifts."""
        return self if self.over_y is None else replace(self, frames=(*self.frames, *frames))

    def part(self, frame: int) -> slice:
        """Index range of the parameters of a frame."""
        if frame not in self.frames:
            return slice(0, 0)
        start = self.each * self.frames.index(frame)
        return slice(start, start + self.each)

    def columns(self, observation: FrameObservation) -> tuple[Columns, ...]:
        """Basis rows at the scan addresses of the sighting's frame."""
        if self.over_y is None or observation.frame not in self.frames:
            return ()
        index, value = self.over_y.local(observation.y_px)
        return (Columns(Axis.X, self.part(observation.frame).start + index, value),)
