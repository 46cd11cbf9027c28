"""Small runs, their estimate pair by pair, and the same as one least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from semlive import estimate as estimating
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.elimination.shared_parameters import parameter_indices, temporal_splines
from semlive.estimate.joint.observations.design_columns import map_columns
from semlive.estimate.joint.observations.priors import gauge_precision, prior_precision
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.estimate.joint.solution.posterior import Solution

GRID = Grid(40, 40, 20, 10, 8, 43)
PHASES = (Phase.CALIBRATION, Phase.CALIBRATION, Phase.TRANSLATION, Phase.CALIBRATION, Phase.TENSION, Phase.TENSION)
UNSURE = (0, 2, 3, 5)  # pairs whose frames began a little earlier or later than stated
SETTINGS = EstimateSettings(drift_knots_per_frame=1.0, distortion_knot_px=80.0)


def when(frame: int, start_s: float, sigma_s: float = 0.0) -> FrameTime:
    def from_config(value: float) -> Sourced[float]:
        return Sourced(value, Provenance.CONFIG)

    timing = ScanTiming(from_config(1e-4), from_config(0.05), from_config(12.0), Sourced(1, Provenance.CONFIG))
    return FrameTime(frame, start_s, timing, sigma_s)


def times(pair: int, pause_s: float = 0.0) -> tuple[FrameTime, FrameTime]:
    """With a pause before pair 2, and one as long before pair 4."""
    begin_s = 60.0 * pair + pause_s * (pair // 2)
    return when(2 * pair, begin_s), when(2 * pair + 1, begin_s + 14.0, 0.05 if pair in UNSURE else 0.0)


def exact_times(pair: int) -> tuple[FrameTime, FrameTime]:
    first, second = times(pair)
    return first, replace(second, start_sigma_s=0.0)


def maps(pair: int) -> tuple[DisparityMap, ...]:
    """Drift and a motion, with noise and a tenth of the points missing; the same whenever the pair comes."""
    n = 2 * pair
    frame_pairs = [(n, n + 1)] + ([(0, n), (0, n + 1)] if pair else [])
    shift = np.array([6.0 * np.cos(2.4 * pair), 6.0 * np.sin(2.4 * pair)]) if pair else np.zeros(2)
    found = []
    for reference, current in frame_pairs:
        rng = np.random.default_rng((pair, reference, current))
        drift = 0.02 * (60.0 * (current // 2 - reference // 2) + 14.0 * (current % 2 - reference % 2))
        moved = drift + (shift if reference == 0 else 0.0)
        noise = rng.normal(0, 0.02, (2, *GRID.shape))
        u, v = np.broadcast_to(moved, (2,))[:, None, None] + noise
        status = np.where(rng.random(GRID.shape) < 0.1, PoiStatus.LOW_ZNCC, PoiStatus.CONVERGED).astype(np.uint8)
        sigma = rng.uniform(0.01, 0.03, GRID.shape)
        found.append(DisparityMap(reference, current, GRID, u.copy(), v.copy(), sigma, 1.3 * sigma, np.ones(GRID.shape), status))
    return tuple(found)


def accumulated(order: tuple[int, ...], pause_s: float = 0.0) -> EstimatorState:
    state = estimating.init(SETTINGS, GRID, 280, 240)
    for pair in order:
        state = estimating.update(state, pair, PHASES[pair], times(pair, pause_s), maps(pair))
    return state


def about_of(state: EstimatorState, rng_seed: int) -> np.ndarray:
    """A point to linearise about that does not depend on the order of the pairs."""
    about = np.zeros(state.layout.size)
    rng = np.random.default_rng(rng_seed)
    for name in ("distortion", "drift"):
        part = state.layout.part(name)
        about[part] = 0.3 * rng.normal(size=part.stop - part.start)
    start = state.layout.part("motion").start
    for pair in state.motions.pairs:
        part, kind = state.motions.part(pair)
        about[start + part.start : start + part.stop] = 1e-3 * np.random.default_rng((rng_seed, pair)).normal(size=kind.value)
    return about


def at_once(state: EstimatorState, prior: np.ndarray, prior_gradient: Callable[[np.ndarray], np.ndarray] | None = None) -> np.ndarray:
    """All rows of all maps in one least squares, noise of frame 0 among its unknowns, nothing integrated out, refined by its rows.

    `asked_of` gives the prior times parameters where the product with the matrix itself would be too coarse.
    """
    n, blocks = state.layout.size, state.blocks.size
    total, rows_of_all = np.zeros((n + 2 * blocks,) * 2), []
    total[:n, :n] = prior
    level = np.zeros((blocks, 2))
    for rows in sorted(state.rows, key=lambda item: (item.current, item.reference)):
        for axis, (index, design) in enumerate(map_columns(state, rows, state.linearisation_point)):
            whole, weight = np.zeros((blocks, n + 2 * blocks)), rows.weight[:, axis]
            whole[:, index] = design
            if rows.reference == 0:
                whole[:, n + axis * blocks : n + (axis + 1) * blocks] = -np.eye(blocks)
                level[:, axis] = np.where(level[:, axis] > 0, level[:, axis], weight)
            total += whole.T @ (whole * weight[:, None])
            rows_of_all.append((whole, weight, rows.disparity_px[:, axis]))
    noise = np.where(level > 0, level, 1.0).T.ravel()
    total[np.arange(n, len(total)), np.arange(n, len(total))] += noise
    scale = 1.0 / np.sqrt(np.diag(total))
    factor = np.linalg.inv(total * scale[:, None] * scale)
    solved = np.zeros(len(total))
    for _ in range(3):
        believed = prior @ solved[:n] if prior_gradient is None else prior_gradient(solved[:n])
        requests = -np.concatenate((believed, noise * solved[n:]))
        requests += np.sum([whole.T @ (weight * (value - whole @ solved)) for whole, weight, value in rows_of_all], axis=0)
        solved += factor @ (requests * scale) * scale
    return solved[:n]


def named(state: EstimatorState, parameters: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters by what they mean, whatever the order in which the pairs came."""
    by_pair = ("motion", "start_time")
    found = {name: parameters[state.layout.part(name)] for name, size in state.layout.of_each() if size and name not in by_pair}
    motion, starts = (parameters[state.layout.part(name)] for name in by_pair)
    late = [state.start_time_errors.late_px(2 * pair + 1, starts) for pair in sorted(state.start_time_errors.pairs)]
    found["drift"] = np.concatenate((found["drift"], *late))  # as far as the drift had gone on
    return found | {f"motion {pair}": motion[state.motions.part(pair)[0]] for pair in state.motions.pairs}


def close(found: dict[str, np.ndarray], frame_pairs: dict[str, np.ndarray]) -> bool:
    """Within 1e-9 of the largest parameter of each part."""
    return all(np.abs(found[name] - item).max() <= 1e-9 * max(np.abs(item).max(), 1e-3) for name, item in frame_pairs.items())


def batch_of(solution: Solution) -> dict[str, np.ndarray]:
    """All rows at once with a solution's choices, linearised where it is."""
    state, border, scale = solution.state, solution.shared_posterior.chain.border, solution.hyper.noise_scale**2
    gauge, belief = gauge_precision(state), prior_precision(state, solution.hyper)
    in_time = [
        (parameter_indices(state.layout, item.codes(0, item.spline.size)), item) for item in temporal_splines(state, solution.hyper, border)
    ]
    rest = belief.copy()
    for at, _ in in_time:
        rest[np.ix_(at, at)] = 0.0
    rest += gauge

    def prior_gradient(parameters: np.ndarray) -> np.ndarray:
        """By differences of knots: with third differences of 1e-5 px the product with the matrix loses six digits."""
        total = rest @ parameters
        for at, item in in_time:
            total[at] += item.prior_gradient(0, item.spline.size, parameters[at])
        return total * scale

    return named(state, at_once(state, (gauge + belief) * scale, prior_gradient))
