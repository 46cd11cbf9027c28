"""What moves the picture: the specimen stage, slow and not quite where it is told, and the beam's shift, quick but crooked."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

from pydantic import ConfigDict

from semlive_simulators.kernels.pattern import gaussian

_X_STREAM, _Y_STREAM, _YAW_STREAM = 11, 12, 13


class Actuator(StrEnum):
    """What is moved."""

    STAGE = "stage"
    BEAM_SHIFT = "beam_shift"


@dataclass(frozen=True, slots=True)
class StageParameters:
    """What kind of stage it is.

    Attributes:
        speed_um_s: of the motors.
        travel_um: largest commanded position in either axis.
        scale_x: true motion per encoder motion along x.
        scale_y: the same along y.
        nonorthogonality_rad: how much less than 90 degrees lie between the axes.
        backlash_um: what a motor turns before the table follows.
        position_noise_um: standard deviation of where a move ends, which the encoder sees.
        encoder_noise_um: standard deviation of one encoder reading.
        yaw_rad: standard deviation of the table's yaw after a move, clipped at one and a half.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    speed_um_s: float
    travel_um: float
    scale_x: float
    scale_y: float
    nonorthogonality_rad: float
    backlash_um: float
    position_noise_um: float
    encoder_noise_um: float
    yaw_rad: float


BEAM_SHIFT = StageParameters(
    speed_um_s=100.0, travel_um=50.0, scale_x=1.03, scale_y=0.96, nonorthogonality_rad=0.035, backlash_um=0.0,
    position_noise_um=0.005, encoder_noise_um=0.0, yaw_rad=0.0,
)  # fmt: skip
"""A beam shift: coils have no backlash and turn nothing, but their gains are percents off and their axes 2 degrees."""


@dataclass(frozen=True, slots=True)
class StageState:
    """Where motors and table are, um."""

    moving: bool = False
    move_count: int = 0
    goal_x_um: float = 0.0
    goal_y_um: float = 0.0
    motor_x_um: float = 0.0
    motor_y_um: float = 0.0
    table_x_um: float = 0.0
    table_y_um: float = 0.0
    yaw_rad: float = 0.0
    goal_yaw_rad: float = 0.0
    stalled: bool = False


def start_move(state: StageState, parameters: StageParameters, x_um: float, y_um: float, seed: int) -> StageState:
    """Start a move; where it really ends and how the table yaws depends on the seed and the number of the move."""
    number = state.move_count + 1
    yaw = max(-1.5, min(1.5, gaussian(seed, _YAW_STREAM, number))) * parameters.yaw_rad
    return replace(
        state,
        moving=True,
        stalled=False,
        move_count=number,
        goal_x_um=x_um + parameters.position_noise_um * gaussian(seed, _X_STREAM, number),
        goal_y_um=y_um + parameters.position_noise_um * gaussian(seed, _Y_STREAM, number),
        goal_yaw_rad=yaw,
    )


def stop(state: StageState) -> StageState:
    """Stop where it is; also acknowledges a fault."""
    return replace(state, moving=False, stalled=False)


def stall(state: StageState) -> StageState:
    """Something is in the way: it stops with a fault until the next order."""
    return replace(state, moving=False, stalled=True)


def step(state: StageState, parameters: StageParameters, dt_s: float) -> StageState:
    """The stage `dt_s` of experiment time later."""
    if not state.moving:
        return state
    way_x, way_y = state.goal_x_um - state.motor_x_um, state.goal_y_um - state.motor_y_um
    distance = math.hypot(way_x, way_y)
    reach = parameters.speed_um_s * dt_s
    part = 1.0 if distance <= reach else reach / distance
    motor_x, motor_y = state.motor_x_um + part * way_x, state.motor_y_um + part * way_y
    return replace(
        state,
        moving=part < 1.0,
        motor_x_um=motor_x,
        motor_y_um=motor_y,
        table_x_um=_dragged(state.table_x_um, motor_x, parameters.backlash_um),
        table_y_um=_dragged(state.table_y_um, motor_y, parameters.backlash_um),
        yaw_rad=state.yaw_rad + part * (state.goal_yaw_rad - state.yaw_rad),
    )


def _dragged(table_um: float, motor_um: float, backlash_um: float) -> float:
    """A play operator: the table rests until the motor has taken up the slack."""
    return max(motor_um - 0.5 * backlash_um, min(motor_um + 0.5 * backlash_um, table_um))


def true_position_um(state: StageState, parameters: StageParameters) -> tuple[float, float]:
    """Where the specimen is, (x, y) along the image axes."""
    slant = parameters.nonorthogonality_rad
    x = parameters.scale_x * state.table_x_um + parameters.scale_y * math.sin(slant) * state.table_y_um
    return x, parameters.scale_y * math.cos(slant) * state.table_y_um
