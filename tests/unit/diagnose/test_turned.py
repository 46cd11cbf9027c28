"""What two runs decide of which the second's scan was turned."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.observing import observed
from numexp.world import SCAN
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import Outcome, ParameterEstimate
from semlive.data.diagnosis.two_runs import TwoRunVerdict
from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.experiments.proposals import ExperimentKind
from semlive.diagnose.experiments.protocols import SQUARE_SHIFTS, protocol_for, square_px, within_travel
from semlive.diagnose.two_runs.decide import compare_runs
from semlive.diagnose.two_runs.disc_basis import AFFINE, DiscDistortion, modes
from semlive.diagnose.two_runs.scan_axes import ScanAxes, StageResponse, axes_between
from semlive.diagnose.two_runs.scan_rotation import analyse_scan_rotation, fields_of, verdict
from semlive.errors import IllPosed
from semlive_simulators.effects.image_field import AnisotropicPixel, ScanNonorthogonality
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.scan_deflection import ScanNonlinearity
from semlive_simulators.microscope.scan import Scan

Field = Callable[[NDArray[np.float64]], NDArray[np.float64]]
MOVES = tuple((x, y) for x, y in square_px(150.0))[:9]
MAP_GRID = Grid(200, 200, 60, 11, 9, 43)
ASKEW = replace(SCAN, rotation_rad=math.radians(88.0))
RADIUS_PX, HALF_PX = 360.0, np.array([511.5, 441.5])


def run(seed: int, effects: tuple[Effect, ...], scan: Scan, bent_like: int | None, pairs: int = len(MOVES)) -> HyperparameterGrid:
    conditions = Conditions(
        seed, pairs, 0, moves_px=MOVES, stage_error_px=0.2, scan=scan, bent_like=bent_like, of_column=True
    )  # fmt: skip
    return noise_scaled_baseline(observed(conditions, effects, MAP_GRID))


def both(seed: int, *effects: Effect, scan: Scan = ASKEW) -> tuple[HyperparameterGrid, HyperparameterGrid]:
    return run(seed, effects, SCAN, None), run(seed + 1000, effects, scan, seed)


def values_and_sigmas(found: TwoRunVerdict) -> dict[str, tuple[float, float]]:
    assert found.turned is not None
    every = (
        found.turned.angle_rad,
        found.turned.x_excess,
        found.turned.skew,
        *(item for entry in found.effects for item in entry.parameters),
    )
    return {entry.name: (entry.value, entry.sigma) for entry in every}


def near(found: tuple[float, float], true: float, within: float) -> bool:
    """Whether a value is within three of its own sigmas, and those are small enough to determine its sign."""
    return abs(found[0] - true) < 3.0 * found[1] < 3.0 * within


@pytest.fixture(scope="module")
def plain() -> tuple[HyperparameterGrid, HyperparameterGrid]:
    """Nothing hidden: the column's own distortion, and a stage that errs."""
    return both(51)


def test_a_distortion_of_the_column_is_nothing(plain: tuple[HyperparameterGrid, HyperparameterGrid]) -> None:
    found = compare_runs(plain)
    assert (found.outcome, found.effect, found.effects, found.ambiguous) == (Outcome.NONE, None, (), ())
    assert found.turned is not None
    assert found.turned.follows == "column"
    assert max(factor for _, factor in found.evidence) < 7.0
    assert near(values_and_sigmas(found)["turn_rad"], math.radians(88.0), 2e-3)


def test_axes_are_named_each_with_its_own_sign() -> None:
    found = compare_runs(both(52, AnisotropicPixel(0.012), ScanNonorthogonality(-0.008)))
    assert found.outcome is Outcome.IDENTIFIED
    assert [entry.name for entry in found.effects] == ["anisotropic_pixel", "scan_nonorthogonality"]
    assert found.effect == found.effects[0]
    assert near(values_and_sigmas(found)["x_excess"], 0.012, 2e-3)
    assert near(values_and_sigmas(found)["skew_rad"], -0.008, 2e-3)
    assert found.effects[0].peak_px == pytest.approx(0.012 * 511.5, rel=0.3)


def test_curved_ramps_are_separated_from_a_lens() -> None:
    found = compare_runs(both(53, ScanNonlinearity(-0.3, 0.2, 0.0)))
    assert [entry.name for entry in found.effects] == ["scan_nonlinearity"]
    assert found.turned is not None
    assert found.turned.follows == "both"
    for name in ("quadratic_x_px", "quadratic_y_px"):
        assert near(values_and_sigmas(found)[name], -0.3, 0.03)


def test_a_scan_that_was_not_turned_is_recognised_by_its_times(plain: tuple[HyperparameterGrid, HyperparameterGrid]) -> None:
    first, _ = plain
    assert analyse_scan_rotation((first, first)) is None
    with pytest.raises(IllPosed, match="equal scan times"):
        compare_runs((first, run(1051, (), SCAN, 51, 7)))


def test_a_scan_that_was_turned_and_slowed_is_refused(plain: tuple[HyperparameterGrid, HyperparameterGrid]) -> None:
    slow = replace(ASKEW, dwell_time_s=0.5 * SCAN.dwell_time_s, frame_time_s=0.5 * SCAN.frame_time_s)
    with pytest.raises(IllPosed, match="and has another dwell"):
        compare_runs((plain[0], run(1051, (), slow, 51, 7)))


def turning(degrees: float) -> NDArray[np.float64]:
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[cos, sin], [-sin, cos]])  # the picture turns against the scan


def carried(scan: NDArray[np.float64], seed: int, play_px: float = 0.0, reach_px: float = 100.0) -> StageResponse:
    """A stage of its own scale and skew, with play that is the same in every run, seen by a scan."""
    rng, commanded = np.random.default_rng(seed), np.array(square_px(reach_px))
    stage = np.array([[1.04, 0.05], [-0.03, 0.91]])
    observation = (
        commanded @ stage.T + rng.normal(0.0, 0.05, commanded.shape) + play_px * np.random.default_rng(0).normal(size=(13, 2))
    ) @ scan.T
    late = np.linspace(-1.0, 1.0, len(commanded))
    base = np.linalg.qr(np.stack([np.ones_like(late), late, late**2], axis=-1))[0]
    moves, observation = (entry - base @ (base.T @ entry) for entry in (commanded, observation))
    by = np.linalg.lstsq(moves, observation, rcond=None)[0].T
    return StageResponse(by, moves, observation - moves @ by.T)


@pytest.mark.parametrize("degrees", [90.0, -90.0, 45.0, 135.0])
@pytest.mark.parametrize("play_px", [0.0, 2.0])
def test_neither_the_stage_nor_its_play_is_taken_for_the_scan(degrees: float, play_px: float) -> None:
    axes = np.linalg.inv(np.eye(2) - np.array([[0.01, 0.004], [0.0, 0.0]]))
    found = axes_between(carried(axes, 1, play_px), carried(axes @ turning(degrees), 2, play_px))
    assert found is not None
    assert near((found.turn.value, found.turn.sigma), math.radians(degrees), 1e-3)
    assert near((found.x_excess.value, found.x_excess.sigma), 0.01, 1e-3)
    assert near((found.skew.value, found.skew.sigma), 0.004, 1e-3)


def test_uncertainties_are_the_scatter_whether_both_runs_went_one_way_or_not() -> None:
    for reach_px, freedom in ((100.0, 16), (70.0, 32)):
        off = []
        for seed in range(200):
            found = axes_between(carried(np.eye(2), 2 * seed), carried(turning(90.0), 2 * seed + 1, reach_px=reach_px))
            assert found is not None
            assert found.freedom == freedom
            off += [entry.value / entry.sigma for entry in (found.x_excess, found.skew)]
        assert 0.9 < float(np.std(off)) < 1.25  # of Student's t, 1.07 and 1.03


@pytest.mark.parametrize("degrees", [0.0, 3.0, 180.0, -178.0])
def test_a_turn_that_shows_no_axes_is_none(degrees: float) -> None:
    assert axes_between(carried(np.eye(2), 1), carried(turning(degrees), 2)) is None


def lens(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """px at places on the unit disc: of the column."""
    x, y = at.T
    return np.stack((0.4 * x**2 + 0.2 * x * y, 0.3 * y**3 - 0.1 * x * y), axis=-1)


def coil(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same of the scan."""
    x, y = at.T
    return np.stack((0.2 * y**2 - 0.3 * x * y, 0.1 * x**2), axis=-1)


def ramps(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """What ramps of 0.2 px along x and -0.3 px along y, at the frame's edge, do."""
    x, y = (at * RADIUS_PX / HALF_PX).T
    return np.stack((0.2 * x**2, -0.3 * y**2), axis=-1)


def ring(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Alike from all sides."""
    return 0.3 * at * np.sum(at**2, axis=-1, keepdims=True)


def nothing(at: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.zeros_like(at)


@pytest.mark.parametrize(
    ("of_column", "of_scan", "follows"),
    [
        (lens, nothing, "column"),
        (nothing, coil, "scan"),
        (lens, ramps, "both"),
        (lens, coil, "neither"),
        (ring, nothing, ""),
        (nothing, nothing, ""),
    ],
)
def test_a_distortion_belongs_where_it_stays(of_column: Field, of_scan: Field, follows: str) -> None:
    between, mode_fields, rng, sigma = turning(90.0), modes(), np.random.default_rng(3), 0.002
    observation = []
    for turn in (np.eye(2), between):
        field = of_column(mode_fields.at @ turn) @ turn.T + of_scan(mode_fields.at)  # E2(R) = T E1(T^-1 R)
        exact = mode_fields.project(field)[AFFINE:].T
        observation.append(DiscDistortion(exact + rng.normal(0.0, sigma, exact.shape), sigma**2 * np.eye(exact.size), np.zeros((2, 2))))
    axes_found = (ParameterEstimate(name, value, 1e-3, "1") for name, value in (("turn_rad", 1.57), ("x_excess", 0.02), ("skew_rad", 0.0)))
    axes = ScanAxes(between, 1e-8 * np.eye(4), *axes_found, 20)
    found = verdict(axes, fields_of(observation, axes, RADIUS_PX, HALF_PX), HALF_PX)
    assert found.turned is not None
    assert found.turned.follows == follows
    named = {entry.name for entry in found.effects}
    of_axes = {"anisotropic_pixel"} if follows != "neither" else set()  # another distortion has another affine part, too
    assert named == of_axes | ({"scan_nonlinearity"} if follows in ("scan", "both") else set())
    assert found.outcome is (Outcome.UNKNOWN if follows == "neither" else Outcome.IDENTIFIED if named else Outcome.NONE)
    if follows == "both":
        assert near(values_and_sigmas(found)["quadratic_x_px"], 0.2, 0.03)
        assert near(values_and_sigmas(found)["quadratic_y_px"], -0.3, 0.03)


def test_the_proposed_experiment_has_moves_that_separate_the_models() -> None:
    before = {"calibration_shifts_px": [[0.0, 0.0], [8.0, 0.0]], "loads_n": [10.0], "recentre_beyond_px": 5.0}
    protocol = protocol_for(before, ExperimentKind.ROTATED_SCAN)
    shifts = np.array(protocol["calibration_shifts_px"])
    assert np.abs(shifts).max() == 150.0
    assert (len(shifts), protocol["loads_n"], protocol["recentre_beyond_px"]) == (len(SQUARE_SHIFTS), [], None)
    near_by = np.array(within_travel(protocol, 80.0)["calibration_shifts_px"])
    assert near_by == pytest.approx(shifts * 80.0 / 150.0)
    assert within_travel(protocol, 200.0) == protocol
