"""Tables of qualified microscopes: how many intervals contain the truth, and how often the limit is named."""

from __future__ import annotations

import math
import pickle
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from qualify_microscopes import CHARACTERS, Case, character_of, qualified
from qualify_still import Truth
from scipy import stats

from semlive.qualify.values import Figure

FIRST_SEED, FIRST_SEED_OF_ROW_MOTION = 23_000, 33_000
"""Seeds of the final count; none of them was used while the code was changed. Microscopes with motion of the rows were drawn again after
the amplitudes of their waves had been corrected.
"""
ROW_MOTION = "hum, vibration or jitter"
LEVEL = 0.95
EXACT = 1e-5
"""Relative error of a figure without an uncertainty, such as a ratio of times of 1 us."""
SAME = 1.15
"""Ratio of two strains below which either source is the limit."""
MIN_PRESENT = 0.1
"""Smallest true strain of a named source relative to the largest; a smaller one is not there."""
UNCORRECTED = ("image_noise", "mains_hum", "vibration", "row_jitter", "wrong_row_time")
"""Sources whose strain remains in a run; drift, distortion and the errors of shifts are measured and corrected."""
SETTLING = ("flyback_settling", "row_start_settling_in_position")
EFFECTS = ("mains_hum", "vibration", "row_jitter", "wrong_row_time", *SETTLING)
MAX_MINUTES = 30.0


@dataclass(frozen=True, slots=True)
class Counted:
    """A figure with its truth.

    Attributes:
        figure: as stated.
        truth: true value.
    """

    figure: Figure
    truth: Truth

    @property
    def inside(self) -> bool:
        """Whether the interval contains the truth, whose own uncertainty is added in squares."""
        margin, stated = EXACT * abs(self.figure.value), self.figure
        below, above = (math.hypot(part, 1.96 * self.truth.sigma) for part in (stated.value - stated.low, stated.high - stated.value))
        return stated.value - below - margin <= self.truth.value <= stated.value + above + margin


def cases(count: int, folder: Path | None) -> list[Case]:
    """Qualified microscopes; those in the folder are read again, and others are added to it."""
    found = list[Case]()
    for number in range(count):
        path = None if folder is None else folder / f"microscope_{number:03d}.pickle"
        if path is not None and path.is_file():
            found.append(pickle.loads(path.read_bytes()))
            continue
        found.append(qualified(number, seed_of(number)))
        if path is not None:
            path.write_bytes(pickle.dumps(found[-1]))
        sys.stderr.write(f"\r{number + 1}/{count} ")
    return found


def seed_of(number: int) -> int:
    """Seed of a microscope."""
    return number + (FIRST_SEED_OF_ROW_MOTION if character_of(number) == ROW_MOTION else FIRST_SEED)


def counted(found: Sequence[Case]) -> dict[str, list[Counted]]:
    """Figures with a truth by name; those of all subsets are one."""
    by_name: dict[str, list[Counted]] = {}
    for case in found:
        for figure in case.found.figures:
            truth = case.truths.get(figure.name)
            if truth is not None and not _absent(case, figure.name):
                name = re.sub(r"^noise_\d+$", "noise", figure.name)
                by_name.setdefault(name, []).append(Counted(figure, truth))
    return by_name


def _absent(case: Case, name: str) -> bool:
    """Whether a figure belongs to an effect that is not there."""
    return any(name.startswith(effect) and effect not in case.strains for effect in EFFECTS)


def band(count: int) -> tuple[int, int]:
    """Numbers of intervals with the truth, of `count` right ones, in 95 % of cases."""
    low, high = stats.binom.ppf((0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)), count, LEVEL)
    return int(low), int(high)


def coverage_rows(found: Sequence[Case]) -> Iterator[tuple[str, bool]]:
    """Lines of the table of the intervals, each with whether the number is within its band or above."""
    for name, items in counted(found).items():
        inside, true = sum(item.inside for item in items), np.array([item.truth.value for item in items])
        low, high = band(len(items))
        half = np.median([0.5 * (item.figure.high - item.figure.low) for item in items])
        unit = f" {items[0].figure.unit}" if items[0].figure.unit else ""
        size = f"{true.min():.3g} to {true.max():.3g}{unit} | {half:.2g}"
        yield f"| `{name}` | {inside} of {len(items)} | {low} to {high} | {size} |", inside >= low


def right_names(strains: dict[str, float]) -> set[str]:
    """Names of the largest source, and of those within 15 % of it."""
    largest = max(strains.values())
    return {name for name, strain in strains.items() if SAME * strain >= largest}


def named(name: str, strains: dict[str, float]) -> str:
    """``named``, ``wrong`` (the source is not there) or ``missed``."""
    name = "row_start_settling" if name in SETTLING else name
    if name in right_names(strains):
        return "named"
    return "missed" if strains.get(name, 0.0) >= MIN_PRESENT * max(strains.values()) else "wrong"


def limit_rows(found: Sequence[Case]) -> Iterator[tuple[str, bool]]:
    """Lines of the table of the limits by character, and of all."""
    total = np.zeros((2, 3), dtype=int)
    for character in CHARACTERS:
        mine = [case for case in found if case.character == character]
        counts = np.zeros((2, 3), dtype=int)
        for case in mine:
            corrected = {name: strain for name, strain in case.strains.items() if name in UNCORRECTED}
            limits = ((case.found.limiting, dict(case.strains)), (case.found.limiting_corrected, corrected))
            for at, (name, strains) in enumerate(limits):
                counts[at, ("named", "missed", "wrong").index(named(name, strains))] += 1
        total += counts
        if mine:
            yield _limit_line(character, len(mine), counts), True
    good = bool(np.all(total[:, 0] >= LEVEL * len(found)) and np.all(total[:, 2] <= 0.01 * len(found)))
    yield _limit_line("all", len(found), total), good or len(found) < 20


def _limit_line(character: str, count: int, counts: np.ndarray) -> str:
    cells = " | ".join(f"{int(value)}" for value in counts.ravel())
    return f"| {character} | {count} | {cells} |"


def further_rows(found: Sequence[Case]) -> Iterator[tuple[str, bool]]:
    """Beam time, and effects that are stated but are not there."""
    minutes = np.array([case.beam_s / 60.0 for case in found])
    text = f"{np.median(minutes):.1f} ({minutes.min():.1f} to {minutes.max():.1f})"
    yield f"| median beam time of the plan, minutes (smallest and largest) | {text} |", bool(np.median(minutes) <= MAX_MINUTES)
    stated = [{effect for figure in case.found.figures for effect in EFFECTS if figure.name.startswith(effect)} for case in found]
    absent = sum(bool(effects - set(case.strains)) for effects, case in zip(stated, found, strict=True))
    yield f"| microscopes with figures of an effect that is not there | {absent} of {len(found)} |", True
