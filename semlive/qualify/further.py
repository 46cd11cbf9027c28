"""Further steps of a qualification, each with other settings of the scan, chosen by what its pairs leave uncertain."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from semlive.qualify.figures.setups import MAGNIFIED, ROW_TIME, TURNED
from semlive.qualify.values import SAME_DWELL, Figure, Qualification

CROSS = ((0, 0), (2, 0), (-2, 0), (0, 2), (0, -2))
"""Shifts of a further step, in halves of the largest: as few as determine a distortion and the axes of the scan."""
IN_PLACE = ((0, 0),) * 3
DWELL_FACTOR, MAX_LONGER_S = 2.0, 60.0
"""Factor of the dwell time of a further step; its inverse, if frames with the longer dwell would take more than this time, s."""
CONTINUOUS = 1.02
"""Largest interval of the frames of a pair, in frame times, that is one of a continuous scan: a gap of 0.4 s after 20 s."""
WIDEST_ROW_TIME = 0.1
"""Largest half width of the interval of a row time ratio that needs no further pairs: fly-back is a tenth of a row or more."""
OTHER_TIME_S = 10.0
"""Assumed time between two pairs without their hold: the move of the stage, and the end of the export, s."""


class StepName(StrEnum):
    """Name of a further step; a value of the option `--step`."""

    ROWS = "rows"
    DWELL = "dwell"
    TURNED = "turned"
    MAGNIFIED = "magnified"


@dataclass(frozen=True, slots=True)
class FurtherStep:
    """A run with other settings of the scan.

    Attributes:
        name: of the step.
        change: what is set at the microscope before the run, an imperative.
        shifts: (x, y) of each pair, in halves of the largest shift.
        time_factor: duration of a frame relative to the first run.
        pixel_factor: pixel size relative to the first run.
    """

    name: StepName
    change: str
    shifts: tuple[tuple[int, int], ...]
    time_factor: float = 1.0
    pixel_factor: float = 1.0

    def duration_s(self, frame_s: float, hold_s: float) -> float:
        """Expected beam time for frames of the first run of `frame_s`, s."""
        return len(self.shifts) * (2.0 * self.time_factor * frame_s + hold_s + OTHER_TIME_S)


@dataclass(frozen=True, slots=True)
class Proposal:
    """A further step and why it is needed, a clause."""

    step: FurtherStep
    reason: str


def further_step(name: StepName, frame_s: float) -> FurtherStep:
    """A step by its name.

    Args:
        name: of the step.
        frame_s: duration of a frame of the first run; 0 if unknown.
    """
    factor = DWELL_FACTOR if DWELL_FACTOR * frame_s <= MAX_LONGER_S else 1.0 / DWELL_FACTOR
    steps = (
        FurtherStep(name.ROWS, "scan half of the rows, with the same width, dwell time and magnification", IN_PLACE, 0.5),
        FurtherStep(name.DWELL, f"set {factor:g} times the dwell time", CROSS, factor),
        FurtherStep(name.TURNED, "turn the scan by 90 degrees", CROSS),
        FurtherStep(name.MAGNIFIED, "double the magnification", CROSS, pixel_factor=0.5),
    )
    return next(step for step in steps if step.name is name)


def proposals(found: Qualification) -> tuple[Proposal, ...]:
    """The further steps that the qualification needs, the shortest first; empty if it needs none."""
    return tuple(Proposal(further_step(name, _frame_s(found)), reason) for name, reason in _reasons(found))


def _frame_s(found: Qualification) -> float:
    return found.conditions.frame_s if found.conditions.timed else 0.0


def _reasons(found: Qualification) -> Iterator[tuple[StepName, str]]:
    figures = {figure.name: figure for figure in found.figures}
    missing = {item.name for item in found.undetermined}
    row_times = [figure for setup in found.setups for figure in setup.figures if figure.name == ROW_TIME]
    half = min((0.5 * (figure.high - figure.low) for figure in row_times), default=math.inf)
    interval = figures.get("frame_interval")
    if interval is not None and interval.high > CONTINUOUS and half > WIDEST_ROW_TIME:
        pause = "which is a pause or a row time that is too short in the files"
        precision = f", and the pairs with fewer rows determine the row time to {100.0 * half:.0f} %" if row_times else ""
        yield StepName.ROWS, f"the frames of a pair begin {interval.value:.3g} frame times apart, {pause}{precision}"
    settles = "row_start_law" in missing
    dwell_s = found.conditions.dwell_s
    if not any(abs(setup.dwell_s - dwell_s) > SAME_DWELL * dwell_s for setup in found.setups):
        if settles:
            yield StepName.DWELL, "one dwell time does not show whether the row start settles in time or in position"
        elif "unexplained_noise" in (found.limiting, found.limiting_corrected):
            yield StepName.DWELL, "one dwell time does not show whether the unexplained noise is averaged by a longer one"
    if TURNED.name in missing and _is_oblique(figures):
        yield StepName.TURNED, "the axes of the stage in the image are oblique or of unequal scale, by the stage or by the scan"
    if MAGNIFIED.name in missing and (settles or "distortion" in (found.limiting, found.limiting_corrected)):
        effect = "settling at the row start" if settles else "distortion, which limits the strain,"
        yield StepName.MAGNIFIED, f"one magnification does not show how the {effect} changes with it"


def _is_oblique(figures: dict[str, Figure]) -> bool:
    """Whether the stage axes in the image are neither at a right angle nor of equal scale within their intervals."""
    if "stage_angle" not in figures:
        return False
    angle, x, y = (figures[name] for name in ("stage_angle", "stage_scale_x", "stage_scale_y"))
    return not angle.low <= 90.0 <= angle.high or x.high < y.low or y.high < x.low
