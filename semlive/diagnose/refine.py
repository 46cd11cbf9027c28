"""Refinement: what is not linear in an effect, between the values of the grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from semlive.data.diagnosis import FoundParameter
from semlive.diagnose.baseline import Found, Ladder
from semlive.diagnose.evidence import Projected, Weighed, projected, sizes_of
from semlive.model.effects import Family, Law, Theta

Array = NDArray[np.float64]
PASSES, ACROSS = 2, 12
CLOSE = 1e-3  # of the distance between values on the grid
UNSEEN = 1e12


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The likeliest law of a family.

    Attributes:
        family: which.
        found: its columns, ready to be added to the baseline.
        field_px: (f, b, 2, q) the same in px for unit amplitudes.
        amplitudes: (q,) most likely.
        covariance: (q, q) of them.
        values: of what is not linear.
        parameters: what people call them.
    """

    family: Family
    found: Found
    field_px: Array
    amplitudes: Array
    covariance: Array
    values: tuple[tuple[str, float], ...]
    parameters: tuple[FoundParameter, ...]

    @property
    def peak_px(self) -> float:
        """The largest displacement since frame 0 of any block."""
        moved = self.field_px @ self.amplitudes
        return float(np.max(np.hypot(*np.moveaxis(moved - moved[0], -1, 0))))


def refined(ladder: Ladder, weighed: Weighed) -> Refined:
    """The likeliest law of a family, refined a parameter at a time."""
    family, (law_at, rung, size_at) = weighed.family, weighed.best
    size_px = float(sizes_of(family)[size_at])
    values, spread = _between(ladder, family, weighed.values[law_at], rung, size_px)
    law = family.law(ladder.design.observation.scene, values)
    assert law is not None  # it was seen on the grid
    against = projected(ladder, law.field_px)
    mean, covariance = against.amplitudes(rung, size_px)
    told = (
        *_linear(law, mean, covariance),
        *(FoundParameter(one.name, values[one.name], spread[one.name], one.unit) for one in family.thetas),
    )
    return Refined(family, Found(ladder.design.whiten(law.field_px), size_px), law.field_px, mean, covariance, tuple(values.items()), told)


def _between(
    ladder: Ladder, family: Family, start: dict[str, float], rung: int, size_px: float
) -> tuple[dict[str, float], dict[str, float]]:
    """The likeliest values between the neighbours on the grid, and their standard uncertainties."""
    values, spread = {one.name: 0.0 for one in family.thetas} | dict(start), dict[str, float]()
    for _ in range(PASSES if family.thetas else 0):
        for theta in family.thetas:
            values[theta.name], spread[theta.name] = _searched(ladder, family, values, theta, rung, size_px)
    return values, spread


def _searched(ladder: Ladder, family: Family, values: dict[str, float], theta: Theta, rung: int, size_px: float) -> tuple[float, float]:
    """The best between the neighbours on the grid, and the standard uncertainty from the likelihood's curvature."""
    start = values[theta.name]

    def at(way: float) -> float:
        return start * theta.step**way if theta.ratio else start + theta.step * way

    def score(way: float) -> float:
        law = family.law(ladder.design.observation.scene, {**values, theta.name: at(way)})
        return -UNSEEN if law is None else _score(projected(ladder, law.field_px), rung, size_px)

    found: Any = minimize_scalar(
        lambda way: -score(float(way)), bounds=(-1.0, 1.0), method="bounded", options={"xatol": CLOSE, "maxiter": ACROSS}
    )
    way, top, width = float(found.x), -float(found.fun), 0.1
    bend = 2.0 * top - score(way - width) - score(way + width)
    sigma_way = width / math.sqrt(bend) if bend > 0.0 else 1.0
    return at(way), abs(at(way + min(sigma_way, 1.0)) - at(way))


def _score(one: Projected, rung: int, size_px: float) -> float:
    return float(one.log_factor(np.array([size_px]))[rung, 0])


def _linear(law: Law, mean: Array, covariance: Array) -> tuple[FoundParameter, ...]:
    told = [
        FoundParameter(one.name, float(one.row @ mean), float(np.sqrt(one.row @ covariance @ one.row)), one.unit) for one in law.reported
    ]
    if law.scatter is not None:
        name, unit, factor = law.scatter
        square = float(np.mean(mean**2 + np.diag(covariance)))
        slope = mean / (len(mean) * math.sqrt(square))
        sampling = square / (2.0 * len(mean))
        told.append(
            FoundParameter(name, factor * math.sqrt(square), factor * math.sqrt(float(slope @ covariance @ slope) + sampling), unit)
        )
    return tuple(told)
