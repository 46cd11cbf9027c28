"""A stage that the operator moves: semlive requests a move, and the operator confirms it."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semlive.data.loading import DeviceIdentity, MotionState, StageKind, StageSample, StopOnLinkLoss
from semlive.errors import BadConfig
from semlive.inputs.kinds import changed_kind
from semlive.ports import ClockSource
from semlive_drivers.modbus import stage as modbus
from semlive_drivers.operator.console import TERMINAL, Console
from semlive_drivers.operator.rehearsal import RehearsedStage


class OperatorSettings(BaseModel):
    """Settings of the operator stage."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    um_per_px: float | None = Field(default=None, gt=0)
    """Edge of a pixel on the specimen, for requests in pixels as well; None requests micrometres only."""
    kind: StageKind = StageKind.SPECIMEN
    """What it moves: the specimen, or the beam."""
    rehearsal: dict[str, Any] | None = None
    """Settings of the `modbus` driver for a simulated stage that obeys the answers, as in `semlive demo --operator`."""


def move_instruction(dx_um: float, dy_um: float, kind: StageKind, um_per_px: float | None) -> str:
    """The request for a move, as a text."""
    components = ((dx_um, ("right", "left")), (dy_um, ("down", "up")))
    parts = [f"{_amount(abs(by_um), um_per_px)} {directions[by_um < 0]}" for by_um, directions in components if abs(by_um) > 0]
    return f"move the {kind} about {' and '.join(parts) or 'nowhere'} in the image, then press enter"


def _amount(by_um: float, um_per_px: float | None) -> str:
    return f"{by_um:.1f} um" if um_per_px is None else f"{by_um / um_per_px:.0f} px ({by_um:.1f} um)"


class OperatorStage:
    """The Stage port over a person. The state is MOVING until a move is confirmed; the position is then the commanded one.

    Args:
        settings: validated settings.
        clock: experiment time.
        console: terminal for the requests.
    """

    def __init__(self, settings: OperatorSettings, clock: ClockSource, console: Console) -> None:
        self._settings, self._clock, self._console = settings, clock, console
        self._lock = threading.Lock()
        self._position_um = (0.0, 0.0)
        self._requested_um: tuple[float, float] | None = None
        self._sequence = 0

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of a stage that the daemon cannot move and need not stop."""
        return DeviceIdentity("stage moved by hand", simulated=False, stop_on_link_loss=StopOnLinkLoss.VERIFIED)

    @property
    def kind(self) -> StageKind:
        """What it moves."""
        return self._settings.kind

    def read(self) -> StageSample:
        """The commanded position; the previous one until the move is confirmed."""
        sequence, self._sequence = self._sequence, self._sequence + 1
        with self._lock:
            x_um, y_um = self._position_um
            motion = MotionState.STOPPED if self._requested_um is None else MotionState.MOVING
        return StageSample(sequence, self._clock.now_ns(), self._clock.mono_ns(), x_um, y_um, motion)

    def move_to(self, x_um: float, y_um: float) -> None:
        """Show the request for a move to a position, um; returns at once."""
        with self._lock:
            dx_um, dy_um = x_um - self._position_um[0], y_um - self._position_um[1]
            self._requested_um = (x_um, y_um)
        self._console.ask(move_instruction(dx_um, dy_um, self._settings.kind, self._settings.um_per_px), self._confirmed)

    def stop(self) -> None:
        """Withdraw the request; the position remains the last confirmed one."""
        with self._lock:
            withdrawn, self._requested_um = self._requested_um is not None, None
        self._console.withdraw(self._confirmed)
        if withdrawn:
            self._console.show("do not move the specimen any more")

    def stop_blind(self) -> bool:
        """Show the request not to move any more, as `semlive.ports.BlindStop`."""
        self.stop()
        return True

    def close(self) -> None:
        """Withdraw an open request."""
        self._console.withdraw(self._confirmed)

    def _confirmed(self, line: str) -> bool:
        """Confirm the move; any line confirms."""
        del line
        with self._lock:
            if self._requested_um is not None:
                self._position_um, self._requested_um = self._requested_um, None
        return True


def open_stage(settings: Mapping[str, object], clock: ClockSource, *, console: Console = TERMINAL) -> OperatorStage | RehearsedStage:
    """A stage that the operator moves on requests at the terminal.

    Raises:
        BadConfig: for settings that are not valid.
    """
    try:
        config = OperatorSettings.model_validate(dict(settings))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise BadConfig(f"operator stage: {key}: {first['msg']}; it has {', '.join(OperatorSettings.model_fields)}") from None
    changed = changed_kind(settings, config)
    if changed is not None:
        raise BadConfig(f"operator stage: {'.'.join(map(str, changed[0]))}: {changed[1]}")
    hand = OperatorStage(config, clock, console)
    return hand if config.rehearsal is None else RehearsedStage(hand, modbus.open_stage(config.rehearsal, clock))
