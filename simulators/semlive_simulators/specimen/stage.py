"""Actuators that shift the image: the specimen stage, slow and with position errors, and the beam shift, fast and with scale errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

from pydantic import ConfigDict

from semlive_simulators.kernels.pattern import gaussian

_X_STREAM, _Y_STREAM, _YAW_STREAM = 11, 12, 13


class Actuator(StrEnum):
    """Kind of an actuator."""

    STAGE = "stage"
    BEAM_SHIFT = "beam_shift"


@dataclass(frozen=True, slots=True)
class StageParameters:
    """Parameters of a stage or of a beam shift.

    Attributes:
        speed_um_s: speed of the motors, um/s.
        travel_um: largest commanded position in each axis, um.
        scale_x: true motion per encoder motion along x.
        scale_y: true motion per encoder motion along y.
        nonorthogonality_rad: 90 degrees minus the angle between the axes, rad.
        backlash_um: motion of a motor before the table follows, um.
        position_noise_um: standard deviation of the end of a move, which the encoder measures, um.
        encoder_noise_um: standard deviation of one encoder reading, um.
        yaw_rad: standard deviation of the yaw after a move, clipped at 1.5 standard deviations, rad.
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
"""A typical beam shift: no backlash and no yaw, but errors of some percent in scale and 2 degrees in angle."""


@dataclass(frozen=True, slots=True)
class StageState:
    """State of motors and table; positions in um."""

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
    """Start a move; its end position and yaw depend on the seed and the number of the move."""
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
    """Stop; also acknowledges a fault."""
    return replace(state, moving=False, stalled=False)


def stall(state: StageState) -> StageState:
    """The state after an obstacle: stopped with a fault until the next order."""
    return replace(state, moving=False, stalled=True)


def step(state: StageState, parameters: StageParameters, dt_s: float) -> StageState:
    """The state after a time step `dt_s`, s."""
    if not state.moving:
        return state
    dx_um, dy_um = state.goal_x_um - state.motor_x_um, state.goal_y_um - state.motor_y_um
    distance_um = math.hypot(dx_um, dy_um)
    travel_um = parameters.speed_um_s * dt_s
    fraction = 1.0 if distance_um <= travel_um else travel_um / distance_um
    motor_x, motor_y = state.motor_x_um + fraction * dx_um, state.motor_y_um + fraction * dy_um
    return replace(
        state,
        moving=fraction < 1.0,
        motor_x_um=motor_x,
        motor_y_um=motor_y,
        table_x_um=_dragged(state.table_x_um, motor_x, parameters.backlash_um),
        table_y_um=_dragged(state.table_y_um, motor_y, parameters.backlash_um),
        yaw_rad=state.yaw_rad + fraction * (state.goal_yaw_rad - state.yaw_rad),
    )


def _dragged(table_um: float, motor_um: float, backlash_um: float) -> float:
    """A play operator: the table does not move until the motor has passed the backlash."""
    return max(motor_um - 0.5 * backlash_um, min(motor_um + 0.5 * backlash_um, table_um))


def true_position_um(state: StageState, parameters: StageParameters) -> tuple[float, float]:
    """True position of the specimen, (x, y) along the image axes, um."""
    angle_rad = parameters.nonorthogonality_rad
    x = parameters.scale_x * state.table_x_um + parameters.scale_y * math.sin(angle_rad) * state.table_y_um
    return x, parameters.scale_y * math.cos(angle_rad) * state.table_y_um
