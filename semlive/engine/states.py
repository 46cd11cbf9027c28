"""States of the protocol, and the one table of transitions.

Theory of operation
-------------------
A run goes once through CONNECTING and READY, then for every step of the plan round this loop::

    RAMPING ---> SETTLING ---> HOLDING ---> IMAGING ---> STEP_DONE ---> RAMPING of the next step, or COMPLETE
       ^            |  ^          |            |
       +------------+  +----------+------------+
     approach again      disturbed: load or stage left tolerance, or moved

RAMPING is the only state in which motion is ordered: the stage first, then the load, never both at once. SETTLING waits
until everything stays within tolerance for the settle time. HOLDING is the rest before imaging. IMAGING waits for two frames.

Where the plan has a warm-up gate, STEP_DONE leads to WARMING before the first load: from there to RAMPING of that step when the forecast
drift is slow enough, to RAMPING of a further pair until then, or to PAUSED when that takes too long. After translations STEP_DONE leads
to JUDGING before the first load: from there on, or to PAUSED when they do not determine the distortion.

Any doubt leads to FAULT with motion stopped. Nothing leaves FAULT by itself: the operator resumes to RECOVER, which asks, and
resumes again to re-enter the step from RAMPING with its full hold. PAUSED re-enters the step in the same way. Loading is path
dependent, so no state rewinds or unloads.

A run that was interrupted after its last pair is COMPLETE from IDLE: no device is asked for anything.

Rule 1: everything that changes state is in TRANSITIONS, and a pair that is not in it raises. The engine has no other way to
another state.
"""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType


class State(StrEnum):
    """Where a run is."""

    IDLE = "idle"
    CONNECTING = "connecting"
    READY = "ready"
    RAMPING = "ramping"
    SETTLING = "settling"
    HOLDING = "holding"
    IMAGING = "imaging"
    STEP_DONE = "step_done"
    CALIBRATION_GATE = "judging"
    WARM_UP = "warming"
    PAUSED = "paused"
    STOPPING = "stopping"
    FAULT = "fault"
    RESUMING = "recover"
    EMERGENCY_STOP = "estopped"
    COMPLETE = "complete"
    ABORTED = "aborted"


class Cause(StrEnum):
    """Why a run changes state."""

    OPENING = "opening"
    LINKED = "linked"
    RECONNECTED = "linked_again"
    START = "start"
    STAGE_ARRIVED = "stage_arrived"
    ARRIVED = "arrived"
    APPROACH_AGAIN = "approach_again"
    SETTLED = "settled"
    HOLD_COMPLETE = "hold_over"
    DISTURBED = "disturbed"
    PAIR_COMPLETE = "pair_complete"
    NEXT_STEP = "next_step"
    LAST_STEP = "last_step"
    WARM_UP = "warm_up"
    MEASURE_AGAIN = "measure_again"
    WARMED_UP = "warm"
    WARM_UP_TIMEOUT = "warm_up_timeout"
    CALIBRATION_CHECK = "judge"
    CALIBRATION_ACCEPTED = "judged"
    POOR_CALIBRATION = "poor_calibration"
    PAUSE = "pause"
    RESUME = "resume"
    STOP = "stop"
    AT_REST = "at_rest"
    STOP_UNCONFIRMED = "stop_unconfirmed"
    ABORT = "abort"
    LIMIT = "limit"
    LINK_LOST = "link_lost"
    DEVICE_FAULT = "device_fault"
    DEVICE_STOPPED = "device_stopped"
    NOT_REACHED = "not_reached"
    MOTION_TIMEOUT = "motion_timeout"
    FRAME_TIMEOUT = "frame_timeout"
    EMERGENCY = "emergency"


FINAL_STATES = frozenset({State.COMPLETE, State.ABORTED})

_STEP_STATES = (State.RAMPING, State.SETTLING, State.HOLDING, State.IMAGING)
AT_REST_STATES = (State.SETTLING, State.HOLDING, State.IMAGING, State.STEP_DONE, State.CALIBRATION_GATE, State.WARM_UP)
"""States of a step in which no motion is ordered."""
_GATES = (State.CALIBRATION_GATE, State.WARM_UP)
_WATCHED_STATES = (State.CONNECTING, State.READY, *_STEP_STATES, State.STEP_DONE, *_GATES, State.PAUSED, State.RESUMING)
_OPEN_STATES = tuple(state for state in State if state not in FINAL_STATES)
_ANYWHERE_FAULTS = (Cause.LIMIT, Cause.LINK_LOST, Cause.DEVICE_FAULT)

TRANSITIONS = MappingProxyType(
    {
        (State.IDLE, Cause.OPENING): State.CONNECTING,
        (State.IDLE, Cause.LAST_STEP): State.COMPLETE,
        (State.CONNECTING, Cause.LINKED): State.READY,
        (State.CONNECTING, Cause.RECONNECTED): State.RESUMING,
        (State.READY, Cause.START): State.RAMPING,
        (State.RAMPING, Cause.STAGE_ARRIVED): State.RAMPING,
        (State.RAMPING, Cause.APPROACH_AGAIN): State.RAMPING,
        (State.RAMPING, Cause.ARRIVED): State.SETTLING,
        (State.SETTLING, Cause.APPROACH_AGAIN): State.RAMPING,
        (State.SETTLING, Cause.SETTLED): State.HOLDING,
        (State.HOLDING, Cause.DISTURBED): State.SETTLING,
        (State.HOLDING, Cause.HOLD_COMPLETE): State.IMAGING,
        (State.IMAGING, Cause.DISTURBED): State.SETTLING,
        (State.IMAGING, Cause.PAIR_COMPLETE): State.STEP_DONE,
        (State.STEP_DONE, Cause.NEXT_STEP): State.RAMPING,
        (State.STEP_DONE, Cause.LAST_STEP): State.COMPLETE,
        **{(state, Cause.CALIBRATION_CHECK): State.CALIBRATION_GATE for state in (State.STEP_DONE, State.PAUSED, State.RESUMING)},
        (State.CALIBRATION_GATE, Cause.CALIBRATION_ACCEPTED): State.RAMPING,
        (State.CALIBRATION_GATE, Cause.POOR_CALIBRATION): State.PAUSED,
        **{(state, Cause.WARM_UP): State.WARM_UP for state in (State.STEP_DONE, State.CALIBRATION_GATE, State.PAUSED, State.RESUMING)},
        (State.WARM_UP, Cause.MEASURE_AGAIN): State.RAMPING,
        (State.WARM_UP, Cause.WARMED_UP): State.RAMPING,
        (State.WARM_UP, Cause.WARM_UP_TIMEOUT): State.PAUSED,
        **{(state, Cause.PAUSE): State.PAUSED for state in (*_STEP_STATES, *_GATES)},
        (State.PAUSED, Cause.RESUME): State.RAMPING,
        (State.FAULT, Cause.RESUME): State.RESUMING,
        (State.EMERGENCY_STOP, Cause.RESUME): State.RESUMING,
        (State.RESUMING, Cause.RESUME): State.RAMPING,
        **{(state, cause): State.FAULT for state in _WATCHED_STATES for cause in _ANYWHERE_FAULTS},
        (State.CONNECTING, Cause.DEVICE_STOPPED): State.FAULT,
        (State.READY, Cause.DEVICE_STOPPED): State.FAULT,
        (State.RAMPING, Cause.DEVICE_STOPPED): State.FAULT,
        (State.SETTLING, Cause.DEVICE_STOPPED): State.FAULT,
        (State.RAMPING, Cause.NOT_REACHED): State.FAULT,
        (State.SETTLING, Cause.NOT_REACHED): State.FAULT,
        (State.RAMPING, Cause.MOTION_TIMEOUT): State.FAULT,
        (State.SETTLING, Cause.MOTION_TIMEOUT): State.FAULT,
        (State.IMAGING, Cause.FRAME_TIMEOUT): State.FAULT,
        **{(state, Cause.EMERGENCY): State.EMERGENCY_STOP for state in (*_WATCHED_STATES, State.FAULT, State.STOPPING)},
        **{(state, Cause.STOP): State.STOPPING for state in _OPEN_STATES if state is not State.STOPPING},
        (State.STOPPING, Cause.AT_REST): State.ABORTED,
        (State.STOPPING, Cause.STOP_UNCONFIRMED): State.ABORTED,
        **{(state, Cause.ABORT): State.ABORTED for state in _OPEN_STATES},
    }
)


class InvalidTransition(RuntimeError):
    """A state and a cause that are not in the table: a mistake in the engine, never the operator's."""


def next_state(state: State, cause: Cause) -> State:
    """The state that `cause` leads to.

    Raises:
        ImpossibleTransition: if the table has no such pair.
    """
    try:
        return TRANSITIONS[state, cause]
    except KeyError:
        raise InvalidTransition(f"{cause} in state {state} is not in the table of transitions") from None
