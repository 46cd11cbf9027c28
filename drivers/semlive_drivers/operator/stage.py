"""A stage that a hand moves: the operator is asked, and confirms."""

from __future__ import annotations

import threading
from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semlive.data.loading import DeviceIdentity, MotionState, StageKind, StageSample, StopOnLinkLoss
from semlive.errors import BadConfig
from semlive.inputs.kinds import changed_kind
from semlive.ports import ClockSource
from semlive_drivers.operator.console import TERMINAL, Console


class OperatorSettings(BaseModel):
    """Settings of the operator stage."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    um_per_px: float | None = Field(default=None, gt=0)
    """Edge of a pixel on the specimen, to ask for pixels as well; None asks for micrometres only."""
    kind: StageKind = StageKind.SPECIMEN


def move_instruction(dx_um: float, dy_um: float, kind: StageKind, um_per_px: float | None) -> str:
    """What to ask of a hand."""
    parts = [
        f"{_amount(abs(by), um_per_px)} {word[by < 0]}" for by, word in ((dx_um, ("right", "left")), (dy_um, ("down", "up"))) if abs(by) > 0
    ]
    return f"move the {kind} about {' and '.join(parts) or 'nowhere'} in the image, then press enter"


def _amount(by_um: float, um_per_px: float | None) -> str:
    return f"{by_um:.1f} um" if um_per_px is None else f"{by_um / um_per_px:.0f} px ({by_um:.1f} um)"


class OperatorStage:
    """The Stage port over a person. A move says MOVING until it is confirmed; the position is then the commanded one.

    Args:
        settings: checked settings.
        clock: experiment time.
        console: where it is asked.
    """

    def __init__(self, settings: OperatorSettings, clock: ClockSource, console: Console) -> None:
        self._settings, self._clock, self._console = settings, clock, console
        self._lock = threading.Lock()
        self._position_um = (0.0, 0.0)
        self._asked_um: tuple[float, float] | None = None
        self._sequence = 0

    @property
    def identity(self) -> DeviceIdentity:
        """A person: what the daemon cannot move needs no stop."""
        return DeviceIdentity("stage moved by hand", simulated=False, stop_on_link_loss=StopOnLinkLoss.VERIFIED)

    @property
    def kind(self) -> StageKind:
        """What is moved."""
        return self._settings.kind

    def read(self) -> StageSample:
        """The commanded position, or the old one until the move is confirmed."""
        sequence, self._sequence = self._sequence, self._sequence + 1
        with self._lock:
            x_um, y_um = self._position_um
            motion = MotionState.STOPPED if self._asked_um is None else MotionState.MOVING
        return StageSample(sequence, self._clock.now_ns(), self._clock.mono_ns(), x_um, y_um, motion)

    def move_to(self, x_um: float, y_um: float) -> None:
        """Ask for a move and return at once."""
        with self._lock:
            dx_um, dy_um = x_um - self._position_um[0], y_um - self._position_um[1]
            self._asked_um = (x_um, y_um)
        self._console.ask(move_instruction(dx_um, dy_um, self._settings.kind, self._settings.um_per_px), self._confirmed)

    def stop(self) -> None:
        """Take the question back; the position stays what was confirmed last."""
        with self._lock:
            taken_back, self._asked_um = self._asked_um is not None, None
        self._console.withdraw(self._confirmed)
        if taken_back:
            self._console.show("do not move the specimen any more")

    def stop_blind(self) -> bool:
        """Ask not to move any more, as `semlive.ports.BlindStop`."""
        self.stop()
        return True

    def close(self) -> None:
        """Take a question back."""
        self._console.withdraw(self._confirmed)

    def _confirmed(self, line: str) -> bool:
        """Whatever is typed confirms."""
        del line
        with self._lock:
            if self._asked_um is not None:
                self._position_um, self._asked_um = self._asked_um, None
        return True


def open_stage(settings: Mapping[str, object], clock: ClockSource, *, console: Console = TERMINAL) -> OperatorStage:
    """A stage moved by hand, asked and confirmed on the terminal.

    Raises:
        BadConfig: for settings that are not understood.
    """
    try:
        known = OperatorSettings.model_validate(dict(settings))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise BadConfig(f"operator stage: {key}: {first['msg']}; it has {', '.join(OperatorSettings.model_fields)}") from None
    changed = changed_kind(settings, known)
    if changed is not None:
        raise BadConfig(f"operator stage: {'.'.join(map(str, changed[0]))}: {changed[1]}")
    return OperatorStage(known, clock, console)
