"""How drift and distortion may go, before the data: the smoothness that questions are put to, and the precision that it gives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.observation import Observation
from semlive.estimate.arrow import Sides, factored, sides
from semlive.estimate.prior import Hyper, Smoothness, belief_precision, gauge_precision

Array = NDArray[np.float64]

SMOOTHEST_PX, WIDEST_PX = 3e-4, 100.0  # farther apart, the belief's precision has no Cholesky factor in double precision
ROUGHEST_PX = 1.0  # of a drift, from knot to knot, as the estimator has it: with 75 px one followed what a bending had left of the noise
STILL_RAD = 1e-9  # a specimen that turns with each move is an effect with a name of its own
STANDING = 1e-6  # what holds a walk as a whole, in what holds its steps


@dataclass(frozen=True, slots=True)
class DriftBelief:
    """How the drift may go.

    Attributes:
        by: its typical bend, in that of the first choice; 0 where it is as smooth as any.
        wander_px: what a random walk beside that adds from knot to knot.
    """

    by: float
    wander_px: float = 0.0


# The smoothness that the first solution chose was chosen with the effect in the data: an unnamed jump makes the drift rough, and a rough
# drift hides the jump. So every question is put to smoother and rougher drifts too, and the likeliest answer counts.
BENDING = tuple(DriftBelief(by) for by in (0.01, 0.1, 1.0, 10.0, 100.0))
# Bends of one size are no random walk: in runs whose drift wandered by 0.01 px/s^0.5 a walk beside a smooth drift was likelier by a
# logarithm of 130 to 150, and without it swings of 61 to 62 s were named in it that only held-out pairs rejected.
WANDERING = tuple(DriftBelief(0.0, wander_px) for wander_px in (0.0, 0.01, 0.03, 0.1, 0.3, 1.0))
DRIFTS = (*BENDING, *WANDERING)


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Of the baseline's own parameters, before the data.

    Attributes:
        hyper: the smoothness.
        precision: (p, p) of the parameters.
        half_log_det: half the logarithm of its determinant.
    """

    hyper: Hyper
    precision: Array
    half_log_det: float


@dataclass(frozen=True, slots=True, eq=False)
class Beliefs:
    """All beliefs of one observation; they are asked for again whenever the noise is scaled or an effect comes in.

    Attributes:
        observation: its.
        kept: (p,) joint parameters of the estimator that the baseline has.
        sides: which of these act along x or along y alone.
        gauge: (p, p) precision that no smoothness changes.
        known: those with the first choice's distortion, which a verdict asks for again and again: a seventh of its time.
    """

    observation: Observation
    kept: NDArray[np.int64]
    sides: Sides
    gauge: Array
    known: dict[DriftBelief, Belief] = field(default_factory=dict)

    @classmethod
    def of(cls, observation: Observation, kept: NDArray[np.int64]) -> Beliefs:
        """None known yet."""
        whole = sides(observation.state)
        own = Sides(*(np.flatnonzero(np.isin(kept, one)) for one in (*whole.own, whole.shared)))
        return cls(observation, kept, own, gauge_precision(observation.state)[np.ix_(kept, kept)])

    def belief(self, drift: DriftBelief, also: float) -> Belief:
        """With a distortion so much rougher than in the first choice."""
        if also != 1.0:
            return self._made(drift, also)
        if drift not in self.known:
            self.known[drift] = self._made(drift, also)
        return self.known[drift]

    def different(self) -> list[DriftBelief]:
        """Beliefs that differ, the first choice's own smoothness before others: nothing can be smoother than the smoothest."""
        first = self.observation.solution.hyper.drift
        by_kind = {}
        for one in sorted(DRIFTS, key=lambda one: abs(math.log(one.by or 1.0))):
            by_kind.setdefault((_drift_of(first, one), one.wander_px), one)
        return list(by_kind.values())

    def _made(self, drift: DriftBelief, also: float) -> Belief:
        state, first = self.observation.state, self.observation.solution.hyper
        hyper = replace(
            first,
            noise_scale=1.0,
            rotation_rad=STILL_RAD,
            raster_px=(0.0, 0.0),
            drift=_drift_of(first.drift, drift),
            distortion=_scaled(first.distortion, also),
        )
        precision = belief_precision(state, hyper)[np.ix_(self.kept, self.kept)]
        precision[np.diag_indices_from(precision)] += WIDEST_PX**-2.0
        if drift.wander_px:
            self._walk(precision, drift.wander_px)
        precision += self.gauge
        told = hyper if drift.by else replace(hyper, drift=_scaled(first.drift, 1.0))
        return Belief(told, precision, factored(precision, self.sides, 0.0).half_log_det)

    def _walk(self, precision: Array, wander_px: float) -> None:
        """Let the drift walk at random, too: covariances add up."""
        state = self.observation.state
        assert state.drift is not None  # there are pairs
        steps = state.drift.roughness(1)
        walk = np.linalg.inv(steps + STANDING * np.eye(len(steps))) * wander_px**2
        start = state.layout.part("drift").start
        for axis in (0, 1):
            at = np.searchsorted(self.kept, start + axis + 2 * np.arange(len(steps)))
            loose = np.linalg.inv(np.linalg.inv(precision[np.ix_(at, at)]) + walk)
            precision[np.ix_(at, at)] = 0.5 * (loose + loose.T)


def _drift_of(first: Sequence[Smoothness], drift: DriftBelief) -> tuple[Smoothness, Smoothness]:
    if not drift.by:
        return Smoothness(3, SMOOTHEST_PX), Smoothness(3, SMOOTHEST_PX)
    one, two = (replace(kind, size_px=min(kind.size_px, ROUGHEST_PX)) for kind in _scaled(first, drift.by))
    return one, two


def _scaled(kinds: Sequence[Smoothness], by: float) -> tuple[Smoothness, Smoothness]:
    """Without a liking for any period: what swings is to be named."""
    one, two = (replace(kind, size_px=max(kind.size_px * by, SMOOTHEST_PX), swing_knots=0.0) for kind in kinds)
    return one, two
