"""Other magnifications, scan rotations and dwell times: figures of each, and what they show about the axes of the scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import PairMotion
from semlive.data.frame import FrameInfo
from semlive.qualify.figures.intervals import TAILS, about, quantiles, student_quantile
from semlive.qualify.values import SAME_SIZE, SAME_TURN_DEG, Figure, Qualification, ScanSetup, SetupFigures, Trend, Undetermined

Array = NDArray[np.float64]
MIN_MOVES = 4
"""Positions along both axes: three determine the axes without an uncertainty."""
MIN_SINE = 0.5
"""Smallest sine of the turn of the scan: the effect of its axes is proportional to it."""
DRAWS = 4000
ROW_TIME = "row_time_ratio"
TURNED = Undetermined(
    "scan_axes",
    "all frames have one scan rotation, which does not separate the axes of the scan from those of the stage",
    "turn the scan by 90 degrees and take pairs at five shifts along both axes of the stage",
    by_pairs=False,
)
MAGNIFIED = Undetermined(
    "magnification",
    "all frames have one pixel size",
    "take pairs at another magnification, at five shifts along both axes of the stage",
    by_pairs=False,
)


def setup_of(info: FrameInfo) -> ScanSetup:
    """Setup of a frame."""
    rotation = info.column.scan_rotation_deg
    return ScanSetup(1e9 * info.pixel_size_m.value, 0.0 if rotation is None else rotation.value, info.timing.dwell_time_s.value)


@dataclass(frozen=True, slots=True, eq=False)
class SetupMeasurement:
    """Pairs of one setup.

    Attributes:
        setup: the setup.
        commands_px: commanded shift of each pair, px of its frames; None where it is not given.
        motions: measured motion of each pair, in the same order.
        found: their qualification.
        intervals_s: from the start of the first frame of each pair to that of the second.
    """

    setup: ScanSetup
    commands_px: Sequence[tuple[float, float] | None]
    motions: Sequence[PairMotion]
    found: Qualification
    intervals_s: Sequence[float] = ()


def joined(main: SetupMeasurement, others: Sequence[SetupMeasurement]) -> Qualification:
    """The qualification of the main setup, with the figures of the others and the frames that are still missing."""
    turned = any(abs(_stated_turn_deg(main, other)) > SAME_TURN_DEG for other in others)
    sizes = [other.setup.pixel_nm for other in others]
    magnified = any(abs(size - main.setup.pixel_nm) > SAME_SIZE * main.setup.pixel_nm for size in sizes)
    missing = (*(() if turned else (TURNED,)), *(() if magnified else (MAGNIFIED,)))
    setups = tuple(
        SetupFigures(
            **asdict(other.setup),
            pairs=other.found.conditions.pairs,
            figures=(*other.found.figures, *scan_figures(main, other), *row_time_figures(main, other)),
            height_px=other.found.conditions.height_px,
        )
        for other in others
    )
    return replace(main.found, undetermined=(*main.found.undetermined, *missing), setups=setups)


def scan_figures(main: SetupMeasurement, other: SetupMeasurement) -> tuple[Figure, ...]:
    """Turn and scale of the scan between two setups, and for a turned scan its aspect and the angle of its axes.

    The shifts of the image by the stage are S = A T, with the axes A of the scan and T of the stage. A scan turned by R has A R T, so that
    S' S^-1 = A R A^-1 contains no stage. To first order in the symmetric part of A its deviation from R is that of a commutator, which
    shows aspect and shear, and neither scale nor rotation.
    """
    first, second = (_draw_axes(item, seed) for item, seed in ((main, 5), (other, 6)))
    if first is None or second is None:
        return ()
    change = second @ np.linalg.inv(first)
    scale = np.sqrt(np.maximum(np.linalg.det(change), 0.0))
    turn = np.arctan2(change[:, 1, 0] - change[:, 0, 1], change[:, 0, 0] + change[:, 1, 1])
    stated = _stated_turn_deg(main, other)
    # Vendors count the rotation in either sense.
    sign = np.sign(float(np.median(turn))) * np.sign(stated) or 1.0
    error = (np.degrees(turn) - sign * stated + 180.0) % 360.0 - 180.0
    figures = [
        Figure("scan_turn_error", "turn of the scan beyond the stated one", *quantiles(error), "deg", Trend.NONE),
        Figure("pixel_size_ratio", "pixel size relative to the stated one and the main setup", *quantiles(1.0 / scale), "", Trend.NONE),
    ]
    sine = np.sin(turn)
    if abs(float(np.median(sine))) > MIN_SINE:
        aspect = -(change[:, 0, 1] + change[:, 1, 0]) / (2.0 * scale * sine)
        shear = (change[:, 0, 0] - change[:, 1, 1]) / (2.0 * scale * sine)
        figures += [
            Figure("scan_aspect", "scale of the scan along rows over that along columns", *quantiles(1.0 + aspect), "", Trend.NONE),
            Figure("scan_shear", "deviation of the axes of the scan from a right angle", *quantiles(1e3 * shear), "mrad", Trend.NONE),
        ]
    return tuple(figures)


def row_time_figures(main: SetupMeasurement, other: SetupMeasurement) -> tuple[Figure, ...]:
    """Row time relative to the stated one, from frames with another number of rows; empty without them.

    The interval of the frames of a pair is that of their rows and of a pause. The pause does not depend on the number of rows, so that the
    difference of the intervals is that of the rows, fly-back included.
    """
    given = [one.found.conditions for one in (main, other)]
    first, second = (np.asarray(one.intervals_s, dtype=np.float64) for one in (main, other))
    stated_s, other_rows = given[0].frame_s - given[1].frame_s, given[0].height_px != given[1].height_px
    same_scan = main.setup.is_same(other.setup) and given[0].width_px == given[1].width_px
    freedom = len(first) + len(second) - 2
    if not (other_rows and same_scan and all(one.timed for one in given)) or min(len(first), len(second)) < 2:
        return ()
    variance = (len(first) * first.var() + len(second) * second.var()) / freedom
    sigma_s = float(np.sqrt(variance * (1.0 / len(first) + 1.0 / len(second))))
    half = student_quantile(TAILS[1], freedom) * sigma_s / abs(stated_s)
    title = "row time relative to the stated one"
    note = "from frames with another number of rows, after which the pause is the same"
    return (Figure(ROW_TIME, title, *about(float(first.mean() - second.mean()) / stated_s, half), "", Trend.NONE, note),)


def _stated_turn_deg(main: SetupMeasurement, other: SetupMeasurement) -> float:
    return (other.setup.rotation_deg - main.setup.rotation_deg + 180.0) % 360.0 - 180.0


def _draw_axes(given: SetupMeasurement, seed: int) -> Array | None:
    """(d, 2, 2) draws of the matrix from commanded to measured shifts; None if the positions do not determine it."""
    moves = [(command, motion.shift_px) for command, motion in zip(given.commands_px, given.motions, strict=True) if command is not None]
    if len(moves) < MIN_MOVES:
        return None
    commands, shifts = (np.array(values, dtype=np.float64) for values in zip(*moves, strict=True))
    commands, shifts = commands - commands.mean(axis=0), shifts - shifts.mean(axis=0)
    normal = commands.T @ commands
    if np.linalg.cond(normal) > 1e4:
        return None
    solved, freedom = np.linalg.solve(normal, commands.T @ shifts), 2 * len(moves) - 6
    sigma = np.sqrt(np.sum((shifts - commands @ solved) ** 2) / freedom)
    root = np.linalg.cholesky(np.linalg.inv(normal))
    draws = solved + sigma * root @ np.random.default_rng(seed).standard_t(freedom, (DRAWS, 2, 2))
    return np.asarray(np.swapaxes(draws, 1, 2), dtype=np.float64)
