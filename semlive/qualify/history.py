"""Comparison of qualifications of one microscope over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from semlive.qualify.values import Figure, Qualification, Trend


@dataclass(frozen=True, slots=True)
class FigureHistory:
    """One figure over time.

    Attributes:
        name: canonical name.
        time_ns: start of each qualification that contains it, UTC ns; arbitrary for one without a date.
        figures: the figure in each of them.
    """

    name: str
    time_ns: tuple[int, ...]
    figures: tuple[Figure, ...]

    @property
    def change(self) -> Trend:
        """Direction of the change from the earlier qualifications to the newest beyond both intervals; ``none`` without one.

        The newest figure is compared with the one before it.
        """
        if len(self.figures) < 2:
            return Trend.NONE
        before, newest = self.figures[-2:]
        if newest.low > before.high:
            return Trend.LARGER
        return Trend.SMALLER if newest.high < before.low else Trend.NONE

    @property
    def worse(self) -> bool:
        """Whether the figure became worse beyond both intervals."""
        return self.change is not Trend.NONE and self.change is self.figures[-1].worse


def histories(qualifications: Sequence[Qualification]) -> tuple[FigureHistory, ...]:
    """Every figure over time, in the order of the newest qualification.

    Args:
        qualifications: of one microscope, in the order of time if one of them has no date.
    """
    ordered = list(qualifications)
    if all_dated(ordered):
        ordered.sort(key=lambda qualification: qualification.conditions.time_ns)
    names = dict.fromkeys(figure.name for qualification in reversed(ordered) for figure in qualification.figures)
    found = []
    for name in names:
        entries = [
            (qualification.conditions.time_ns, figure)
            for qualification in ordered
            for figure in qualification.figures
            if figure.name == name
        ]
        found.append(FigureHistory(name, tuple(time_ns for time_ns, _ in entries), tuple(figure for _, figure in entries)))
    return tuple(found)


def all_dated(qualifications: Sequence[Qualification]) -> bool:
    """Whether the time of every qualification is known, so that they can be ordered by it."""
    return all(qualification.conditions.dated for qualification in qualifications)


def comparable(qualifications: Sequence[Qualification]) -> bool:
    """Whether all were made with one frame size, dwell time and pixel size, without which changes are not those of the microscope."""
    return len({(q.conditions.width_px, q.conditions.height_px, q.conditions.dwell_s, q.conditions.pixel_nm) for q in qualifications}) <= 1
