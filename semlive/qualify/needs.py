"""What further pairs must determine before a qualification can end."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from semlive.qualify.limits import REFERENCE_SHIFT_PX
from semlive.qualify.protocol import GAUGE_PX
from semlive.qualify.values import Figure, Qualification

WIDEST_NOISE, WIDEST_FALSE_STRAIN = 0.15, 0.5
"""Largest half width of a 95 % interval as a share of its figure. That of a drift rate is of one pair; further pairs do not narrow it."""
NEGLIGIBLE = 0.5
"""Share of the strain noise at the reference gauge below which a false strain is known well enough, however wide its interval is."""
NECESSARY = ("noise", "drift_rate", "drift_decay", "distortion", "stage", "stage_backlash_x", "stage_backlash_y")
"""Quantities without which a qualification continues to its last pair."""


@dataclass(frozen=True, slots=True)
class Need:
    """A figure that is not known well enough.

    Attributes:
        name: of the figure.
        reason: a clause.
        pairs: further pairs that narrow its interval enough; None if the planned pairs determine it for the first time.
    """

    name: str
    reason: str
    pairs: int | None


def needs(qualification: Qualification) -> tuple[Need, ...]:
    """The figures that are not known well enough; empty if the qualification can end."""
    return (*_missing(qualification), *_wide(qualification))


def remaining_pairs(found: tuple[Need, ...], planned: int) -> int:
    """Number of further pairs.

    Args:
        found: the needs.
        planned: number of planned pairs that were not taken.
    """
    return min(planned, max((planned if need.pairs is None else need.pairs for need in found), default=0))


def _missing(qualification: Qualification) -> Iterator[Need]:
    for item in qualification.undetermined:
        if item.name in NECESSARY and item.by_pairs:
            yield Need(item.name, item.reason, None)


def _wide(qualification: Qualification) -> Iterator[Need]:
    figures = {figure.name: figure for figure in qualification.figures}
    resolution = min(qualification.resolution, key=lambda item: abs(item.gauge_px - GAUGE_PX), default=None)
    negligible = 0.0 if resolution is None else NEGLIGIBLE * resolution.noise
    noise, strain = figures.get(f"noise_{qualification.protocol.subset_px}"), figures.get("false_strain_per_px")
    pairs = qualification.conditions.pairs
    if noise is not None:
        yield from _too_wide(noise, WIDEST_NOISE, pairs)
    if strain is not None and REFERENCE_SHIFT_PX * strain.high > negligible:
        yield from _too_wide(strain, WIDEST_FALSE_STRAIN, pairs)


def _too_wide(figure: Figure, widest: float, pairs: int) -> Iterator[Need]:
    """The need of a figure, if its interval is wider than a share of it; an uncertainty decreases with the square root of the pairs."""
    half = _half_width(figure)
    if half > widest:
        further = math.ceil(pairs * ((min(half, 100.0) / widest) ** 2 - 1.0))
        yield Need(figure.name, f"known to {100.0 * half:.0f} %, and {100.0 * widest:.0f} % are needed", further)


def _half_width(figure: Figure) -> float:
    return 0.5 * (figure.high - figure.low) / abs(figure.value) if figure.value else math.inf
