"""Replacements for a load frame and a stage, for runs without one."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.data.loading import ControlMode, DeviceIdentity, LoadSample, MotionState, StageKind, StageSample, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError
from semlive.ports import ClockSource


class NullLoadFrame:
    """A load frame whose load is always zero."""

    def __init__(self, clock: ClockSource) -> None:
        self._clock = clock
        self._sequence = 0

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of a load frame that cannot move and therefore always stops."""
        return DeviceIdentity(
            "no load frame",
            simulated=False,
            stop_on_link_loss=StopOnLinkLoss.VERIFIED,
            control=ControlMode.MANUAL,
            measures_extension=False,
        )

    def read(self) -> LoadSample:
        """A reading of zero load."""
        sequence, self._sequence = self._sequence, self._sequence + 1
        return LoadSample(sequence, self._clock.now_ns(), self._clock.mono_ns(), 0.0, 0.0, MotionState.STOPPED, 0.0)

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Accept a ramp to zero only.

        Raises:
            LinkError: for any other load.
        """
        del rate_n_s
        if force_n != 0.0:
            raise LinkError(f"there is no load frame to go to {force_n:g} N; choose a driver, or take the loads out of the plan")

    def stop(self) -> None:
        """Do nothing: nothing moves."""

    def close(self) -> None:
        """Do nothing: nothing is open."""


class NullStage:
    """A stage that reports each commanded position at once and moves nothing."""

    def __init__(self, clock: ClockSource) -> None:
        self._clock = clock
        self._sequence = 0
        self._position_um = (0.0, 0.0)

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of a stage that cannot move."""
        return DeviceIdentity("no stage", simulated=False, stop_on_link_loss=StopOnLinkLoss.VERIFIED)

    @property
    def kind(self) -> StageKind:
        """The specimen, by convention."""
        return StageKind.SPECIMEN

    def read(self) -> StageSample:
        """The commanded position."""
        sequence, self._sequence = self._sequence, self._sequence + 1
        x_um, y_um = self._position_um
        return StageSample(sequence, self._clock.now_ns(), self._clock.mono_ns(), x_um, y_um, MotionState.STOPPED)

    def move_to(self, x_um: float, y_um: float) -> None:
        """Store the position, um."""
        self._position_um = (x_um, y_um)

    def stop(self) -> None:
        """Do nothing: nothing moves."""

    def close(self) -> None:
        """Do nothing: nothing is open."""


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> NullLoadFrame:
    """No load frame.

    Raises:
        BadConfig: for any setting.
    """
    _no_settings(settings)
    return NullLoadFrame(clock)


def open_stage(settings: Mapping[str, object], clock: ClockSource) -> NullStage:
    """No stage.

    Raises:
        BadConfig: for any setting.
    """
    _no_settings(settings)
    return NullStage(clock)


def _no_settings(settings: Mapping[str, object]) -> None:
    if settings:
        raise BadConfig(f"the null driver has no setting {next(iter(settings))!r}; remove it")
