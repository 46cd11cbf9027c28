"""Backlash, yaw and residual of a stage with known errors are inside their 95 % intervals as often as they should be."""

from __future__ import annotations

import numpy as np

from semlive.data.drift import PairMotion, RasterDrift
from semlive.qualify.figures.stage import stage_results
from semlive.qualify.protocol import STEPS
from semlive.qualify.values import Figure, Undetermined

RUNS = 200
BINOMIAL = 3.0 * np.sqrt(0.95 * 0.05 / RUNS)
COMMANDS = 12.0 * np.array(STEPS, dtype=np.float64)
BACKLASH_PX, SCATTER_PX, YAW_RAD, SIGMA_RAD = (3.0, 0.0), 0.5, 2e-3, 1e-5


def _motions(rng: np.random.Generator, backlash_px: tuple[float, float]) -> list[PairMotion]:
    """Play of a table behind its motors, from an unknown start; then scale, rotation and scatter of the image."""
    table, found = rng.uniform(-0.5, 0.5, 2) * backlash_px, []
    for command in COMMANDS:
        for axis in (0, 1):
            table[axis] = np.clip(table[axis], command[axis] - 0.5 * backlash_px[axis], command[axis] + 0.5 * backlash_px[axis])
        turn, yaw = 0.01, YAW_RAD * rng.standard_normal()
        shift = np.array([[1.01, -turn], [turn, 0.98]]) @ table + SCATTER_PX * rng.standard_normal(2)
        gradient = (yaw + SIGMA_RAD * rng.standard_normal()) * np.array([[0.0, -1.0], [1.0, 0.0]])
        sigma = np.array([[0.0, SIGMA_RAD], [SIGMA_RAD, 0.0]])
        found.append(PairMotion(len(found), shift, np.full(2, 1e-3), gradient, sigma))
    return found


def test_scale_backlash_and_yaw_are_inside_their_intervals() -> None:
    rng = np.random.default_rng(11)
    true = {"stage_backlash_x": 1.01 * BACKLASH_PX[0], "stage_backlash_y": BACKLASH_PX[1], "stage_yaw": 1e3 * YAW_RAD}
    true |= {"stage_scale_x": float(np.hypot(1.01, 0.01)), "stage_scale_y": float(np.hypot(0.98, 0.01))}
    inside = dict.fromkeys(true, 0)
    for _ in range(RUNS):
        found = {item.name: item for item in stage_results([tuple(command) for command in COMMANDS], _motions(rng, BACKLASH_PX))}
        for name, value in true.items():
            figure = found[name]
            assert isinstance(figure, Figure)
            inside[name] += figure.low <= value <= figure.high
    assert all(abs(count / RUNS - 0.95) <= BINOMIAL for count in inside.values()), inside


def test_a_backlash_needs_positions_approached_from_either_side() -> None:
    commands = [(0.0, 0.0), (4.0, 0.0), (8.0, 4.0), (12.0, 8.0), (16.0, 12.0), (20.0, 16.0)]
    motions = [PairMotion(at, np.array(command), np.ones(2), np.zeros((2, 2)), np.zeros((2, 2))) for at, command in enumerate(commands)]
    found = {item.name: item for item in stage_results(commands, motions)}
    for name in ("stage_backlash_x", "stage_backlash_y", "stage_yaw"):
        assert isinstance(found[name], Undetermined), name


def test_a_backlash_longer_than_the_moves_is_not_determined() -> None:
    motions = _motions(np.random.default_rng(12), (14.0, 0.0))
    found = {item.name: item for item in stage_results([tuple(command) for command in COMMANDS], motions)}
    missing = found["stage_backlash_x"]
    assert isinstance(missing, Undetermined)
    assert "moves of 12 px" in missing.reason
    assert isinstance(found["stage_backlash_y"], Figure)


def test_a_yaw_below_its_noise_is_not_excluded() -> None:
    sigma = np.array([[0.0, 1e-5], [1e-5, 0.0]])
    motions = [PairMotion(at, command, np.full(2, 1e-3), np.zeros((2, 2)), sigma) for at, command in enumerate(COMMANDS)]
    found = {item.name: item for item in stage_results([tuple(command) for command in COMMANDS], motions)}
    yaw = found["stage_yaw"]
    assert isinstance(yaw, Figure)
    assert (yaw.low, yaw.value) == (0.0, 0.0)
    assert yaw.high > 0.01


def test_moves_along_both_axes_at_once_do_not_narrow_the_intervals() -> None:
    commands = 12.0 * np.array([(0.0, 0.0), (1.0, 1.0), (-1.0, -0.8), (0.8, 1.0), (-0.6, -1.0), (1.0, 0.6), (-1.0, -1.0), (0.0, 0.0)])
    true = {"stage_scale_x": float(np.hypot(1.01, 0.01)), "stage_scale_y": float(np.hypot(0.98, 0.01))}
    true |= {"stage_backlash_x": 2.0 * true["stage_scale_x"], "stage_backlash_y": 2.0 * true["stage_scale_y"]}
    inside, rng = dict.fromkeys(true, 0), np.random.default_rng(3)
    for _ in range(RUNS):
        motors = commands + 0.3 * rng.standard_normal(commands.shape)
        table, motions = np.zeros(2), list[PairMotion]()
        for motor in motors:
            table = np.clip(table, motor - 1.0, motor + 1.0)
            shift = np.array([[1.01, -0.01], [0.01, 0.98]]) @ table
            motions.append(PairMotion(len(motions), shift, np.full(2, 1e-3), np.zeros((2, 2)), np.zeros((2, 2))))
        found = {item.name: item for item in stage_results([tuple(command) for command in commands], motions)}
        for name, value in true.items():
            figure = found[name]
            assert isinstance(figure, Figure)
            inside[name] += figure.low <= value <= figure.high
    assert all(abs(count / RUNS - 0.95) <= BINOMIAL for count in inside.values()), inside


def test_a_rotation_that_may_be_of_the_raster_is_not_certainly_a_yaw() -> None:
    rng, count = np.random.default_rng(13), len(COMMANDS)
    walk, sigma = 1e-4 * np.cumsum(rng.standard_normal(count)), np.array([[0.0, 1e-5], [1e-5, 0.0]])
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    motions = [PairMotion(at, COMMANDS[at], np.full(2, 1e-3), walk[at] * turn, sigma) for at in range(count)]
    none, twice = np.zeros(2 * count), -np.repeat(walk, 2)
    found = []
    for rotation in (none, twice):
        raster = RasterDrift(np.arange(2 * count), none, none, rotation, none)
        yaw = {item.name: item for item in stage_results([tuple(one) for one in COMMANDS], motions, raster=raster)}["stage_yaw"]
        assert isinstance(yaw, Figure)
        found.append(yaw)
    assert found[0].low > 0.0
    assert (found[1].low, found[1].value) == (0.0, 0.0)
    assert found[1].high == found[0].high
