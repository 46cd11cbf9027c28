"""What the installed distribution promises by name is there."""

from __future__ import annotations

from importlib.metadata import EntryPoint, distribution

import pytest

GROUPS = {
    "console_scripts": {"semlive"},
    "semlive.load_frames": {"modbus", "ascii", "assembled", "operator", "null"},
    "semlive.stages": {"modbus", "operator", "null"},
    "semlive.triggers": {"modbus", "operator", "sharksem", "smartsem", "autoscript"},
    "semlive.frame_checks": {"maps"},
    "semlive.simulators": {"bench", "frames"},
}
POINTS = [point for point in distribution("semlive").entry_points if point.group in GROUPS]


def test_every_group_is_filled() -> None:
    assert {group: {point.name for point in POINTS if point.group == group} for group in GROUPS} == GROUPS


@pytest.mark.parametrize("point", POINTS, ids=lambda point: f"{point.group}:{point.name}")
def test_entry_point_loads(point: EntryPoint) -> None:
    assert callable(point.load())
