"""Drivers by name, from the entry points of installed packages; semlive itself contains no drivers."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Any, cast

from semlive.errors import BadConfig
from semlive.ports import ClockSource, LoadFrame, LoadFrameFactory, OperatorInterface, Stage, StageFactory, Trigger, TriggerFactory


def open_load_frame(driver: str, settings: Mapping[str, object], clock: ClockSource) -> LoadFrame:
    """Open a load frame.

    Raises:
        BadConfig: there is no such driver, or its settings are invalid.
        LinkRefused: the device does not answer.
    """
    return cast(LoadFrameFactory, _factory("load_frames", driver))(settings, clock)


def open_stage(driver: str, settings: Mapping[str, object], clock: ClockSource) -> Stage:
    """Open a stage; raises like `open_load_frame`."""
    return cast(StageFactory, _factory("stages", driver))(settings, clock)


def open_trigger(driver: str, settings: Mapping[str, object], clock: ClockSource) -> Trigger:
    """Open a trigger; raises like `open_load_frame`."""
    return cast(TriggerFactory, _factory("triggers", driver))(settings, clock)


def operator_interfaces() -> Mapping[str, OperatorInterface]:
    """Return the operator interfaces of the installed drivers by name."""
    return {point.name: cast(OperatorInterface, point.load()) for point in entry_points(group="semlive.desks")}


def _factory(group: str, driver: str) -> Any:
    installed = {point.name: point for point in entry_points(group=f"semlive.{group}")}
    if driver not in installed:
        names = ", ".join(sorted(installed)) or "none; is the driver's package installed?"
        raise BadConfig(f"driver {driver}: no such driver among semlive.{group}; installed are {names}")
    return installed[driver].load()
