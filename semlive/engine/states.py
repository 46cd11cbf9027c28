"""States of the protocol, and the one table of transitions.

Theory of operation
-------------------
A run passes once through CONNECTING and READY, and then through this loop for every step of the plan::

    RAMPING ---> SETTLING ---> HOLDING ---> IMAGING ---> STEP_DONE ---> RAMPING of the next step, or COMPLETE
       ^            |  ^          |            |
       +------------+  +----------+------------+
     approach again      disturbed: load or stage left tolerance, or moved

Motion is ordered only in RAMPING: first the stage, then the load, never both at once. SETTLING ends when load and stage have been within
tolerance for the settle time. HOLDING is the wait before imaging. IMAGING ends with two accepted frames.

If the plan has a warm-up gate, STEP_DONE leads to WARM_UP before the first load. WARM_UP leads to RAMPING of the load step when the
forecast drift rate is small enough or has settled, to RAMPING of an additional pair until then, and after the maximum time to PAUSED or, if
no decision is required, to RAMPING of the step. After translations, STEP_DONE leads to CALIBRATION_GATE before the first load, and from
there to the load or, if the translations do not determine the distortion, to PAUSED.

Every fault stops the motion and leads to FAULT. Only the operator can leave FAULT: RESUME leads to RESUMING, which shows the motion that
will follow; a second RESUME repeats the step from RAMPING with its full hold. RESUME in PAUSED repeats the step in the same way. Loading is
path dependent, so no state undoes a step or unloads.

A run that was interrupted after its last pair goes from IDLE to COMPLETE without any command to a device.

All state changes are listed in TRANSITIONS; a pair of state and cause that is not listed raises `InvalidTransition`.
"""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType


class State(StrEnum):
    """State of a run."""

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
    """Cause of a transition."""

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
    WARM_UP_ENDED = "warm_up_ended"
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
        (State.WARM_UP, Cause.WARM_UP_ENDED): State.RAMPING,
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
    """A pair of state and cause that the table does not list: a programming error in the engine, never an error of the operator."""


def next_state(state: State, cause: Cause) -> State:
    """Return the state after a transition.

    Raises:
        InvalidTransition: if the table has no such pair.
    """
    try:
        return TRANSITIONS[state, cause]
    except KeyError:
        raise InvalidTransition(f"{cause} in state {state} is not in the table of transitions") from None
