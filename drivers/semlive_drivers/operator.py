"""A stage that a hand moves: the operator is asked, and confirms."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semlive.data.loading import DeviceIdentity, MotionState, StageKind, StageSample, StopOnLinkLoss
from semlive.errors import BadConfig
from semlive.ports import ClockSource


class OperatorSettings(BaseModel):
    """Settings of the operator stage."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    um_per_px: float | None = Field(default=None, gt=0)
    """Edge of a pixel on the specimen, to ask for pixels as well; None asks for micrometres only."""
    kind: StageKind = StageKind.SPECIMEN


def sentence(dx_um: float, dy_um: float, kind: StageKind, um_per_px: float | None) -> str:
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
        tell: shows one line.
        confirm: blocks until the operator has pressed enter; called in a thread of its own, once per line.
    """

    def __init__(self, settings: OperatorSettings, clock: ClockSource, tell: Callable[[str], None], confirm: Callable[[], object]) -> None:
        self._settings, self._clock, self._tell, self._confirm = settings, clock, tell, confirm
        self._lock = threading.Lock()
        self._position_um = (0.0, 0.0)
        self._asked_um: tuple[float, float] | None = None
        self._listening = False
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
            start_listening, self._listening = not self._listening, True
        self._tell(sentence(dx_um, dy_um, self._settings.kind, self._settings.um_per_px))
        if start_listening:
            threading.Thread(target=self._listen, name="operator stage", daemon=True).start()

    def stop(self) -> None:
        """Take the question back; the position stays what was confirmed last."""
        with self._lock:
            taken_back, self._asked_um = self._asked_um is not None, None
        if taken_back:
            self._tell("do not move the specimen any more")

    def close(self) -> None:
        """Nothing is open."""

    def _listen(self) -> None:
        """Wait for confirmations as long as a question is open; enter pressed without one means nothing."""
        while True:
            self._confirm()
            with self._lock:
                if self._asked_um is not None:
                    self._position_um, self._asked_um = self._asked_um, None
                    self._listening = False
                    return


def open_stage(
    settings: Mapping[str, object],
    clock: ClockSource,
    *,
    tell: Callable[[str], None] | None = None,
    confirm: Callable[[], object] | None = None,
) -> OperatorStage:
    """A stage moved by hand, asked on standard output and confirmed on standard input.

    Raises:
        BadConfig: for settings that are not understood.
    """
    try:
        known = OperatorSettings.model_validate(dict(settings))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise BadConfig(f"operator stage: {key}: {first['msg']}; it has {', '.join(OperatorSettings.model_fields)}") from None
    return OperatorStage(known, clock, tell or _tell, confirm or sys.stdin.readline)


def _tell(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
