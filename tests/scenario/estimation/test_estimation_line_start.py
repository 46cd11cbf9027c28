"""Distortion at the row start: the beam has not settled there, and points are visible from the first column that a subset allows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from semlive import estimate as estimating
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.model import DistortionSpline, UniformSpline
from semlive.model.knots import towards_start
from semlive_simulators.effects.interfaces import PixelVisits
from semlive_simulators.effects.settling import FlybackSettling
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.specimen.specimen import at_rest

WIDTH_PX, HEIGHT_PX, DWELL_S = 1024, 884, 1e-4
GRID = Grid(22, 101, 14, 58, 42, 43)
EDGE_PX = 130.0


def settling(world: Any, effect: FlybackSettling) -> Any:
    """The world seen from the line start on, with the simulator's fly-back on top of its distortion."""
    scan, rest = Scan(WIDTH_PX, HEIGHT_PX, DWELL_S, 94.67, 120.0, 1.25), at_rest()

    class Settling(type(world)):  # type: ignore[misc]
        def distortion(self, at: Any) -> Any:
            x_px = at[..., 0].reshape(1, -1)
            nowhere = np.zeros_like(x_px)
            observed = PixelVisits(x_px, nowhere, nowhere, 0.0, 0, 0, np.zeros((1, 1), dtype=bool), scan, rest, (nowhere, nowhere))
            bend = super().distortion(at)
            bend[..., 0] += effect.offset_px(observed)[0].reshape(at.shape[:-1])
            return bend

    return Settling(world.seed, GRID, world.noise_px)


def errors_px(one: Any, steps: list[Any], initial: EstimatorState) -> tuple[float, float]:
    """Largest error of the distortion along x, its best affine map removed, at the line start and elsewhere."""
    state = initial
    for taken in one.pairs(steps):
        state = estimating.update(state, taken.pair, taken.step.phase, taken.times, taken.maps)
    found = estimating.to_estimate(estimating.solve(state), 0).distortion
    x, y = GRID.mesh()
    error = found.ex_px - one.distortion(np.stack((x, y), axis=-1))[..., 0]
    plane = np.column_stack((np.ones(x.size), x.ravel(), y.ravel()))
    away = x.ravel() > EDGE_PX
    error = error.ravel() - plane @ np.linalg.lstsq(plane[away], error.ravel()[away], rcond=None)[0]
    return float(np.abs(error[~away]).max()), float(np.abs(error[away]).max())


def test_fly_back_is_followed_at_the_line_start(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """3 px that fall off within 10 columns: knots at the usual spacing have 2.6 times that residual there, and twice as much elsewhere."""
    effect, steps = FlybackSettling(3.0, 1e-3), [plans["full"][at] for at in (0, 1, 2, 3, 5, 7, 8, 9, 11)]
    fine = estimating.init(EstimateSettings(), GRID, WIDTH_PX, HEIGHT_PX)
    even = replace(fine, distortion=DistortionSpline.covering(WIDTH_PX, HEIGHT_PX, 100.0))
    nothing = np.zeros((2, fine.blocks.size, even.layout.size))
    n = even.layout.size
    even = replace(even, precision=np.zeros((n, n)), information=np.zeros(n), reference=replace(even.reference, coupling=nothing))
    fine_px, even_px = (errors_px(settling(world(40, noise_px=0.005), effect), steps, initial) for initial in (fine, even))
    assert max(fine_px) < 0.03
    assert even_px[0] > 2 * fine_px[0]
    assert even_px[1] > 1.5 * fine_px[1]


def test_knots_are_closer_only_where_points_are_measured() -> None:
    sizes = [DistortionSpline.covering(WIDTH_PX, HEIGHT_PX, 100.0, first_px).along_x.size for first_px in (0.0, 22.0, 45.0, 101.0)]
    assert np.diff([DistortionSpline.covering(WIDTH_PX, HEIGHT_PX, 100.0).along_x.size, *sizes[::-1]]).tolist() == [0, 1, 1, 1]


def test_a_spline_on_equidistant_knots_is_the_uniform_one_and_polynomials_cost_nothing() -> None:
    uniform, even = UniformSpline(0.0, 90.0, 9, 5), towards_start(810.0, 9, 0, 5)
    x_px = np.linspace(-15.0, 830.0, 60)
    np.testing.assert_array_equal(uniform.local(x_px)[0], even.local(x_px)[0])
    np.testing.assert_allclose(uniform.local(x_px)[1], even.local(x_px)[1], atol=1e-12)
    for order in range(5):
        np.testing.assert_allclose(uniform.roughness(order), even.roughness(order), atol=1e-9)
    closer = towards_start(810.0, 9, 3, 5)
    index, value = closer.local(x_px)
    rows = np.zeros((len(x_px), closer.size))
    np.put_along_axis(rows, index, value, axis=1)
    for degree in range(4):
        straight = np.linalg.lstsq(rows, (x_px / 400.0 - 1.0) ** degree, rcond=None)[0]
        np.testing.assert_allclose(rows @ straight, (x_px / 400.0 - 1.0) ** degree, atol=1e-9)
        assert float(straight @ closer.roughness(degree + 1) @ straight) < 1e-9
