"""Parameter codes that stay constant while the run grows, and the border: parameters that any pair may touch.

Drift, raster and motions grow at their ends, so the index of a parameter in the joint vector changes when the run grows. Its code does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.joint.observations.priors import AXES, BASE_PX, GAUGE_PX, RASTER_PX, STILL_PX, DifferencePenalty, Hyperparameters
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.model import Gap, Layout, UniformSpline, sighting

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]
Codes = NDArray[np.int64]

SHIFT = 40
"""A code is ``kind << SHIFT | index within the effect``."""
KINDS = ("distortion", "drift", "magnification", "raster_rotation", "line_shift", "start_time", "axes", "motion", "noise")
DISTORTION, DRIFT, MOTION, NOISE = (KINDS.index(name) for name in ("distortion", "drift", "motion", "noise"))
AXES_KIND, LINES, STARTS = (KINDS.index(name) for name in ("axes", "line_shift", "start_time"))
INDEX = (1 << SHIFT) - 1


def parameter_codes(layout: Layout, index: NDArray[np.int64]) -> Codes:
    """Codes of joint indices."""
    starts = np.cumsum([0, *layout.sizes[:-1]])
    kind = np.searchsorted(starts, index, side="right") - 1
    return np.asarray((kind << SHIFT) | (index - starts[kind]), dtype=np.int64)


def parameter_indices(layout: Layout, codes: Codes) -> NDArray[np.int64]:
    """Joint indices of codes; the noise of frame 0 has none."""
    starts = np.cumsum([0, *layout.sizes[:-1]])
    return np.asarray(starts[codes >> SHIFT] + (codes & INDEX), dtype=np.int64)


def codes_in_layout(layout: Layout, codes: Codes) -> NDArray[np.bool_]:
    """Which codes exist in a layout. Codes of row shifts disappear if the term is no longer selected."""
    return np.asarray((codes & INDEX) < np.array(layout.sizes)[codes >> SHIFT])


@dataclass(frozen=True, slots=True)
class SharedParameters:
    """Number of parameters of each kind, counted from the first, that any pair may touch.

    The border contains the distortion, the scan axes, the first knots of drift and raster, the rows of frame 0 (touched by every map from
    frame 0), and the noise of frame 0, block by block for x and then for y. All other parameters belong to the time of one pair.

    Attributes:
        counts: number by kind, in the order of `KINDS`.
    """

    counts: tuple[int, ...]

    @classmethod
    def of(cls, state: EstimatorState) -> SharedParameters:
        """Of a state that has a pair."""
        assert state.drift is not None  # it has a pair
        x, y = (coordinates[[0, 0, -1, -1], [0, -1, 0, -1]] for coordinates in state.grid.mesh())
        last_s = float(sighting(state.frame_time(0), x, y).visit_time_s.max())
        knots = [_touched(value, last_s) for value in (state.drift.spline, *(change.spline for change in state.raster))]
        of_time = 2 * knots[0], knots[1], knots[2], state.row_shifts.each, 0
        return cls((state.distortion.size, *of_time, state.axes.size, 0, 2 * state.blocks.size))

    @property
    def size(self) -> int:
        """Number of parameters in the border."""
        return sum(self.counts)

    @property
    def joint_size(self) -> int:
        """Number of these parameters in the joint vector: all but the noise."""
        return self.size - self.counts[NOISE]

    def part(self, kind: int) -> slice:
        """Where one kind lies."""
        start = sum(self.counts[:kind])
        return slice(start, start + self.counts[kind])

    def place(self, codes: Codes) -> NDArray[np.int64]:
        """Position of each code in the border; -1 outside."""
        starts, counts = np.cumsum([0, *self.counts[:-1]]), np.array(self.counts)
        kind, index = codes >> SHIFT, codes & INDEX
        return np.where(index < counts[kind], starts[kind] + index, -1)

    def codes(self) -> Codes:
        """(size,) codes in order."""
        return np.concatenate([(kind << SHIFT) | np.arange(count) for kind, count in enumerate(self.counts)]).astype(np.int64)


@dataclass(frozen=True, slots=True)
class TemporalSpline:
    """A spline in time that the chain follows: one component of the drift, or one term of the raster.

    Attributes:
        kind: of its parameters.
        stride: parameters from knot to knot.
        offset: of the first knot's parameter.
        spline: over time.
        first: knots that belong to the border.
        filters: differences of knots that are believed to be small.
        knot_precision: precision of every knot about zero.
        severed: whether it begins after a pause whose end does not depend on its begin: the knots before the first one continue it.
    """

    kind: int
    stride: int
    offset: int
    spline: UniformSpline
    first: int
    filters: tuple[DifferencePenalty, ...]
    knot_precision: float
    severed: bool = False

    def gaps(self, first: int, stop: int) -> list[Gap]:
        """Gaps between knots first ... stop - 1, counted from `first`, without that before a severed beginning."""
        return [gap for gap in self.spline.gaps_within(first, stop, first) if not self.severed or gap[0] != self.first - first]

    def codes(self, first: int, stop: int) -> Codes:
        """Codes of knots first ... stop - 1."""
        return (self.kind << SHIFT) | (self.offset + self.stride * np.arange(first, stop, dtype=np.int64))

    def belief(self, first: int, stop: int) -> tuple[Codes, Matrix]:
        """Prior of knots first ... stop - 1 given the earlier ones: codes and precision."""
        begin, total = self.since(first), np.zeros((stop - self.since(first),) * 2)
        for penalty in self.filters:
            since = self._since(first, penalty)
            own = slice(since - begin, None)
            rows = penalty.rows(stop - since, self.gaps(since, stop))[max(first - penalty.reach, 0) - since :]
            total[own, own] += penalty.precision * (rows.T @ rows)
        fresh = np.arange(first - begin, stop - begin)
        total[fresh, fresh] += self.knot_precision
        return self.codes(begin, stop), total

    def prior_gradient(self, first: int, stop: int, value: Vector) -> Vector:
        """Prior precision times knot values, computed from differences to avoid cancellation of large values."""
        begin, total = self.since(first), np.zeros(len(value))
        for penalty in self.filters:
            since = self._since(first, penalty)
            own, gaps = slice(since - begin, None), self.gaps(since, stop)
            bent = penalty.of(value[own], gaps)
            bent[: max(first - penalty.reach, 0) - since + self.severed * penalty.reach] = 0.0
            if bent.size:
                total[own] += penalty.precision * penalty.reversed(bent, gaps)
        total[first - begin :] += self.knot_precision * value[first - begin :]
        return total

    def since(self, first: int) -> int:
        """First knot coupled by the prior to knot `first`."""
        return min((self._since(first, penalty) for penalty in self.filters), default=first)

    def _since(self, first: int, penalty: DifferencePenalty) -> int:
        """First knot coupled to knot `first` by one filter: behind a gap, all that it couples before the gap."""
        across = self.spline.gaps_within(first - penalty.reach + 1, first + 1)
        return max(min(first, *(begin for begin, _ in across)) - penalty.reach, 0) if across else max(first - penalty.reach, 0)

    def size_at(self, end_s: float) -> int:
        """Number of knots of a run that ends at `end_s`."""
        return self.spline.shortened(end_s).size

    def interval(self, time_s: float) -> int:
        """First knot with influence at a time or later."""
        return self.spline.first_at(time_s)


def temporal_splines(state: EstimatorState, hyper: Hyperparameters, border: SharedParameters) -> tuple[TemporalSpline, ...]:
    """Temporal splines with their priors."""
    assert state.drift is not None  # there are pairs
    found = [
        TemporalSpline(
            DRIFT, 2, axis, state.drift.spline, border.counts[DRIFT] // 2, (DifferencePenalty(2, BASE_PX**-2.0), smoothness.filter), 0.0
        )
        for axis, smoothness in enumerate(hyper.drift)
    ]
    for change, size_px in zip(state.raster, hyper.raster_px, strict=True):
        kind = KINDS.index(change.name)
        believed = ((DifferencePenalty(2, size_px**-2.0),), RASTER_PX**-2.0) if size_px else ((), STILL_PX**-2.0)
        found.append(TemporalSpline(kind, 1, 0, change.spline, border.counts[kind], *believed))
    return tuple(found)


def distortion_prior(state: EstimatorState, hyper: Hyperparameters) -> Matrix:
    """(m, m) gauge and prior precision of the distortion alone."""
    affine = state.distortion.affine_rows(state.grid) / GAUGE_PX
    bending = state.distortion.roughness() * BASE_PX**-2.0 + affine.T @ affine
    total = np.zeros((state.distortion.size,) * 2)
    for axis, kind in enumerate(hyper.distortion):
        total[axis::2, axis::2] = bending + kind.roughness(state.distortion)
    return total


def shared_prior(state: EstimatorState, hyper: Hyperparameters, border: SharedParameters) -> Matrix:
    """(size, size) gauges and priors of the border alone. The noise of frame 0 is in units of the noise scale of the data."""
    total = np.zeros((border.size,) * 2)
    bent = slice(0, border.counts[DISTORTION])
    total[bent, bent] = distortion_prior(state, hyper)
    for strand in temporal_splines(state, hyper, border):
        codes, believed = strand.belief(0, strand.first)
        at = border.place(codes)
        total[np.ix_(at, at)] += believed
        index, value = strand.spline.local([0.0])
        at = border.place(strand.codes(0, strand.first)[index[0]])
        total[np.ix_(at, at)] += np.outer(value[0], value[0]) / GAUGE_PX**2
    axes = np.arange(border.size)[border.part(AXES_KIND)]
    total[axes, axes] = AXES**-2.0
    lines = np.arange(border.size)[border.part(LINES)]
    total[lines, lines] = hyper.row_shift_px**-2.0 if lines.size else 0.0
    noise = np.arange(border.size)[border.part(NOISE)]
    prior = state.reference.prior.T.ravel()
    # A block that no map ever saw has no noise to speak of; any number keeps it apart.
    total[noise, noise] = np.where(prior > 0, prior, 1.0) * hyper.noise_scale**-2.0
    return total


def _touched(spline: UniformSpline, last_s: float) -> int:
    return int(spline.local(np.array([last_s]))[0].max()) + 1
