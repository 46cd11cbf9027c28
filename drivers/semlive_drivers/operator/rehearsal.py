"""Rehearsal of a run with devices that a person moves: simulated devices do what the person answers.

A device that the operator moves believes the answers. In a rehearsal nobody moves anything, so a simulated machine goes where each answer
states, and the motion ends when the machine is there. Real machines are refused: an answer must never move one.
"""

from __future__ import annotations

import dataclasses

from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StageKind, StageSample
from semlive.errors import BadConfig
from semlive.ports import LoadFrame, OrderCheck, Stage

_NEAR_N = 10.0
_NEAR_UM = 5.0
_RATE_N_S = 1.0
"""Rate before the first request, N/s; no answer is possible then."""


class RehearsedLoadFrame:
    """The LoadFrame port over a person whose typed loads a simulated machine obeys.

    Args:
        hand: the load frame that sends requests to the person.
        machine: the simulated machine.

    Raises:
        BadConfig: the machine is not simulated.
    """

    def __init__(self, hand: LoadFrame, machine: LoadFrame) -> None:
        _check_simulated(machine.identity)
        self._hand, self._machine = hand, machine
        self._load_n = hand.read().force_n
        self._rate_n_s, self._is_going = _RATE_N_S, False

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of the load frame that the person moves."""
        return self._hand.identity

    def read(self) -> LoadSample:
        """The typed load; in motion until the machine has reached it."""
        typed, machine = self._hand.read(), self._machine.read()
        if typed.force_n != self._load_n:
            self._load_n, self._is_going = typed.force_n, True
            self._machine.ramp_to(typed.force_n, self._rate_n_s)
        elif self._is_going:
            self._is_going = machine.motion is not MotionState.STOPPED or abs(machine.force_n - self._load_n) > _NEAR_N
        return dataclasses.replace(typed, motion=MotionState.MOVING) if self._is_going else typed

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Show the request for a load."""
        self._rate_n_s = rate_n_s
        self._hand.ramp_to(force_n, rate_n_s)

    def stop(self) -> None:
        """Show the request to stop, and stop the machine."""
        self._is_going = False
        self._hand.stop()
        self._machine.stop()

    def stop_blind(self) -> bool:
        """Show the request to stop, as `semlive.ports.BlindStop`."""
        self.stop()
        return True

    def order_problem(self, force_n: float, rate_n_s: float) -> str | None:
        """Why a load cannot be requested, or None."""
        return self._hand.order_problem(force_n, rate_n_s) if isinstance(self._hand, OrderCheck) else None

    def close(self) -> None:
        """Withdraw an open request and close the link to the machine."""
        self._hand.close()
        self._machine.close()


class RehearsedStage:
    """The Stage port over a person whose confirmed moves a simulated stage carries out.

    Args:
        hand: the stage that sends requests to the person.
        machine: the simulated stage; its present position is the origin.

    Raises:
        BadConfig: the machine is not simulated.
    """

    def __init__(self, hand: Stage, machine: Stage) -> None:
        _check_simulated(machine.identity)
        self._hand, self._machine = hand, machine
        begin, confirmed = machine.read(), hand.read()
        self._origin_um = (begin.x_um - confirmed.x_um, begin.y_um - confirmed.y_um)
        self._position_um = (confirmed.x_um, confirmed.y_um)
        self._is_going = False

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of the stage that the person moves."""
        return self._hand.identity

    @property
    def kind(self) -> StageKind:
        """What it moves."""
        return self._hand.kind

    def read(self) -> StageSample:
        """The confirmed position; in motion until the machine is there."""
        confirmed = self._hand.read()
        x_um, y_um = confirmed.x_um + self._origin_um[0], confirmed.y_um + self._origin_um[1]
        if (confirmed.x_um, confirmed.y_um) != self._position_um:
            self._position_um, self._is_going = (confirmed.x_um, confirmed.y_um), True
            self._machine.move_to(x_um, y_um)
        elif self._is_going:
            machine = self._machine.read()
            is_near = max(abs(machine.x_um - x_um), abs(machine.y_um - y_um)) <= _NEAR_UM
            self._is_going = machine.motion is not MotionState.STOPPED or not is_near
        return dataclasses.replace(confirmed, motion=MotionState.MOVING) if self._is_going else confirmed

    def move_to(self, x_um: float, y_um: float) -> None:
        """Show the request for a move."""
        self._hand.move_to(x_um, y_um)

    def stop(self) -> None:
        """Show the request not to move any more, and stop the machine."""
        self._is_going = False
        self._hand.stop()
        self._machine.stop()

    def stop_blind(self) -> bool:
        """Show the request not to move any more, as `semlive.ports.BlindStop`."""
        self.stop()
        return True

    def close(self) -> None:
        """Withdraw an open request and close the link to the machine."""
        self._hand.close()
        self._machine.close()


def _check_simulated(machine: DeviceIdentity) -> None:
    if not machine.simulated:
        raise BadConfig(f"rehearsal: {machine.name} is a real machine, which answers must not move; leave the key out")
