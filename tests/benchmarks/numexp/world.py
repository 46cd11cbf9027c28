"""The microscope of the numerical experiment: truth from the simulators' own drift, distortion, effects and column geometry.

Nothing here is a spline, and nothing is imported from the estimator. The scan address R of a material point solves an implicit
equation (drift is taken at the time when the beam is at R), by iteration until it changes by less than 1e-11 px.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.distortion import AxisDistortion, Distortion
from semlive_simulators.effects.drift import AxisDrift, Drift
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.microscope.column import Column
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.specimen import Motion, at_rest

Field: TypeAlias = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX = 1024, 884
DWELL_S, ROW_S, PAUSE_S = 1e-4, 0.1071, 120.0  # the paper prints 1.071e-2 s a row, which its own frame time contradicts
SCAN = Scan(WIDTH_PX, HEIGHT_PX, DWELL_S, HEIGHT_PX * ROW_S, PAUSE_S, 1.25)
STANDS_STILL_PX = 1e-11
MAX_ITERATIONS = 30


@dataclass(frozen=True, slots=True)
class World:
    """One experiment's truth.

    Attributes:
        column: raster, drift and effects.
        distortion: E.
        carried: whether the distortion is carried along by the drift, as equations 6 and 9 of the paper have it (E at R - d);
            otherwise it stays where the beam is (E at R).
    """

    column: Column
    distortion: Distortion
    carried: bool

    def bend_px(self, at_px: Field) -> Field:
        """(..., 2) true distortion at scan addresses (..., 2)."""
        return self.distortion.at(at_px[..., 0], at_px[..., 1], WIDTH_PX, HEIGHT_PX)

    def material_px(self, address_px: Field, frame: int, motion: Motion) -> Field:
        """(n, 2) material points that a frame shows at scan addresses (n, 2)."""
        maps, bend = self._observed(address_px, frame, motion)
        return np.einsum("nij,nj->ni", maps[:, :, :2], address_px - bend) + maps[:, :, 2]

    def address_px(self, material_px: Field, frame: int, motion: Motion, near_px: Field | None = None) -> Field:
        """(n, 2) scan addresses at which a frame shows material points (n, 2); `near_px` is where to begin looking."""
        address = material_px if near_px is None else near_px
        for _ in range(MAX_ITERATIONS):
            maps, bend = self._observed(address, frame, motion)
            found = np.linalg.solve(maps[:, :, :2], (material_px - maps[:, :, 2])[..., None])[..., 0] + bend
            if np.max(np.abs(found - address)) < STANDS_STILL_PX:
                return found
            address = found
        raise RuntimeError(f"scan addresses of frame {frame} do not converge")

    def _observed(self, address_px: Field, frame: int, motion: Motion) -> tuple[Field, Field]:
        """Affine maps (n, 2, 3) and distortion (n, 2) at scan addresses."""
        time_s = start_s(frame) + address_px[:, 0] * DWELL_S + address_px[:, 1] * ROW_S
        bend = self.bend_px(address_px - self.column.drift.at(time_s) if self.carried else address_px)
        return self.column.row_maps(time_s, motion, start_s(frame), frame), bend


def start_s(frame: int) -> float:
    """When a frame begins, seconds after frame 0 began."""
    return frame * (SCAN.frame_time_s + PAUSE_S)


def make_world(
    rng: np.random.Generator,
    run_s: float,
    effects: tuple[Effect, ...],
    carried: bool,
    scan: Scan = SCAN,
    distortion: Distortion | None = None,
) -> World:
    """A world with 10 to 20 px of drift along each axis during `run_s` and a distortion of -0.5 ... 1.5 px.

    Args:
        rng: decides drift and distortion.
        run_s: length of the run.
        effects: what else is wrong.
        carried: see `World`.
        scan: the raster.
        distortion: in place of one of its own.
    """
    drift = Drift(*(_axis_drift(rng, run_s) for _ in range(2)))
    distortion = distortion or Distortion(*(_axis_distortion(rng) for _ in range(2)))
    scenario = replace(_paper(), scan=scan, drift=drift, distortion=distortion, effects=EffectSet(effects))
    return World(scenario.column(), distortion, carried)


@cache
def _paper() -> Scenario:
    """Read once, not three times a case."""
    return load_scenario("paper_x200")


def lying(shift_px: tuple[float, float], gradient: Field) -> Motion:
    """A specimen that lies still, moved and strained."""
    return at_rest(shift_px, gradient)


def _axis_drift(rng: np.random.Generator, run_s: float) -> AxisDrift:
    """Quadratic, always the same way: its rate falls or grows by up to a factor of seven."""
    total_px = rng.uniform(10.0, 20.0) * rng.choice([-1.0, 1.0])
    linear = rng.uniform(0.25, 1.75)
    return AxisDrift(0.0, 1.0, linear * total_px / run_s, (1.0 - linear) * total_px / run_s**2)


def _axis_distortion(rng: np.random.Generator) -> AxisDistortion:
    """A quadratic surface plus a cosine wave of about one period, scaled to the paper's -0.5 ... 1.5 px over the frame."""
    bend = rng.uniform(-1.0, 1.0, 3)
    wave_x, wave_y, phase = rng.uniform(0.5, 1.1), rng.uniform(-0.9, 0.9), rng.uniform(0.0, 2.0 * np.pi)
    raw = AxisDistortion(0.0, *bend, rng.uniform(0.5, 1.0), wave_x, wave_y, phase)
    values = raw.at(*np.meshgrid(np.linspace(-1, 1, 129), np.linspace(-1, 1, 111)))
    scale = 2.0 / np.ptp(values)
    return AxisDistortion(-0.5 - scale * float(values.min()), *(scale * bend), scale * raw.wave_px, wave_x, wave_y, phase)
