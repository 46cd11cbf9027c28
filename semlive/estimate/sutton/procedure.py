"""Published procedure: drift, then distortion and motions, then drift again without distortion, until convergence (Sutton 2007, Fig. 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import FrameTime
from semlive.errors import IllPosed
from semlive.estimate.sutton.bundle import BundleAdjustment, TranslatedImage, adjust
from semlive.estimate.sutton.drift import LocalDrift, Removal, estimated
from semlive.estimate.sutton.state import PairMaps, SuttonState
from semlive.estimate.sutton.surface import Surface

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SuttonOptions:
    """Parameters that the paper does not specify.

    Attributes:
        drift_coefficients: maximum number of coefficients of the spline in time at each position ("reduced order").
        carried: fraction of the drift that advects the distortion: 1 as in equations 6, 9 and 10.
        relaxation: fraction of each new distortion that is applied.
        settled_px: convergence limit: largest change of the distortion at any point of the grid, px.
        passes: maximum number of passes.
        remove_drift: False omits the drift correction, to evaluate its influence.
    """

    drift_coefficients: int = 4
    carried: float = 1.0
    relaxation: float = 0.8
    settled_px: float = 1e-4
    passes: int = 12
    remove_drift: bool = True


PUBLISHED_OPTIONS = SuttonOptions()


@dataclass(frozen=True, slots=True, eq=False)
class SuttonSolution:
    """Drift of each phase, distortion and motions.

    Attributes:
        state: the maps.
        options: parameters that the paper does not specify.
        drifts: one drift for each phase estimated separately.
        bundle: distortion and motions; None before the first translation.
        changes_px: largest change of the distortion in each pass, px.
    """

    state: SuttonState
    options: SuttonOptions
    drifts: tuple[LocalDrift, ...]
    bundle: BundleAdjustment | None
    changes_px: tuple[float, ...]

    @property
    def noise_floor_px(self) -> float:
        """Robust standard deviation of the residual, per component and POI of a map, px."""
        if self.bundle is not None:
            return self.bundle.residual_px
        first = self.state.pairs[0].times
        return self.drifts[0].velocity_sd_px_s * (first[1].start_s - first[0].start_s)

    def drift_of(self, frame: int) -> LocalDrift:
        """Drift of the phase that contains a frame."""
        begin_s = self.state.frame_time(frame).start_s
        return [drift for drift in self.drifts if drift.first.start_s <= begin_s][-1]

    def drift_px(self, address_px: Array, when: FrameTime) -> Array:
        """(n, 2) drift at scan addresses of a frame."""
        return self.drift_of(when.frame).at(address_px, when) if self.options.remove_drift else np.zeros_like(address_px)

    def correction_px(self, address_px: Array, when: FrameTime) -> Array:
        """(n, 2) drift and distortion together at scan addresses of a frame."""
        drift = self.drift_px(address_px, when)
        return drift if self.bundle is None else drift + self.bundle.surface.at(address_px - self.options.carried * drift)


def solve_incremental(state: SuttonState, previous: SuttonSolution | None) -> SuttonSolution:
    """Solution after a further pair with the options of the earlier solution. The procedure is a batch, so the result equals `solve`."""
    return solve(state, previous.options if previous is not None else PUBLISHED_OPTIONS)


def solve(state: SuttonState, options: SuttonOptions = PUBLISHED_OPTIONS) -> SuttonSolution:
    """Complete procedure on all data.

    Raises:
        IllPosed: there are no data, or none within a pair.
    """
    if not state.pairs:
        raise IllPosed("no pair has been accumulated yet, so there is nothing to estimate: add pair 0 first")
    solution = SuttonSolution(state, options, _drifts(state, options, None), None, ())
    images = translated(solution)
    if not images:
        return solution
    here = _grid_points(state)
    flat = _flat(state, [here, *(image.after_px for image in images), *(image.before_px for image in images)])
    for _ in range(options.passes):
        bundle = adjust(translated(solution), flat, here)
        solution = _relaxed(solution, bundle, here)
        if solution.changes_px[-1] <= options.settled_px or not options.remove_drift:
            break
        solution = replace(solution, drifts=_drifts(state, options, _removal(solution)))
    return solution


def _relaxed(solution: SuttonSolution, new: BundleAdjustment, here: Array) -> SuttonSolution:
    """The new motions, with a distortion between the old and the new one; the first distortion is applied completely."""
    old = solution.bundle
    if old is None:
        return replace(solution, bundle=new, changes_px=(float("inf"),))
    step = new.surface.coefficients - old.surface.coefficients
    surface = replace(old.surface, coefficients=old.surface.coefficients + solution.options.relaxation * step)
    change = float(np.abs(surface.at(here) - old.surface.at(here)).max())
    return replace(solution, bundle=replace(new, surface=surface), changes_px=(*solution.changes_px, change))


def _drifts(state: SuttonState, options: SuttonOptions, removal: Removal | None) -> tuple[LocalDrift, ...]:
    smoothing_px = state.settings.sutton_smoothing_px
    return tuple(
        estimated(phase, state.grid, state.height_px, options.drift_coefficients, smoothing_px, removal) for phase in _phases(state)
    )


def _phases(state: SuttonState) -> list[list[PairMaps]]:
    """Calibration and measurement separately (footnote 5), or all pairs together; a phase of one pair is merged with the previous one."""
    pairs = list(state.pairs)
    cut = next((at for at, pair_maps in enumerate(pairs) if not pair_maps.calibrates), len(pairs))
    if not state.settings.sutton_phases_apart or cut == 0 or len(pairs) - cut < 2:
        return [pairs]
    return [pairs[:cut], pairs[cut:]]


def _removal(solution: SuttonSolution) -> Removal | None:
    bundle, carried = solution.bundle, solution.options.carried
    if bundle is None:
        return None

    def removal(before_px: Array, after_px: Array, first: FrameTime, second: FrameTime) -> Array:
        before = before_px - carried * solution.drift_px(before_px, first)
        after = after_px - carried * solution.drift_px(after_px, second)
        return bundle.surface.at(after) - bundle.surface.at(before)

    return removal


def translated(solution: SuttonSolution) -> list[TranslatedImage]:
    """Translated images of the calibration, corrected for drift."""
    state, carried, found = solution.state, solution.options.carried, []
    reference = state.pairs[0].times[0]
    for pair in state.pairs:
        dmap = pair.from_reference
        if dmap is None or not pair.calibrates or not dmap.valid.any():
            continue
        before = _grid_points(state)[dmap.valid.ravel()]
        after = before + np.stack((dmap.u_px[dmap.valid], dmap.v_px[dmap.valid]), axis=1)
        drift_before, drift_after = solution.drift_px(before, reference), solution.drift_px(after, pair.times[0])
        moved = after - drift_after - before + drift_before
        found.append(TranslatedImage(pair.pair, before - carried * drift_before, after - carried * drift_after, moved))
    return found


def _flat(state: SuttonState, addresses: list[Array]) -> Surface:
    low = np.min([address.min(axis=0) for address in addresses], axis=0)
    high = np.max([address.max(axis=0) for address in addresses], axis=0)
    return Surface.flat(low - 1.0, high + 1.0, state.settings.distortion_knot_px)


def _grid_points(state: SuttonState) -> Array:
    return np.stack(state.grid.mesh(), axis=-1).reshape(-1, 2)
