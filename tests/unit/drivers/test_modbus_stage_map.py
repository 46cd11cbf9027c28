"""Where a stage's block of registers begins."""

from __future__ import annotations

import pytest

from semlive.errors import BadConfig
from semlive_drivers.modbus.registers import StageMap, overridden, stage_at
from semlive_drivers.modbus.settings import StageSettings
from semlive_drivers.settings import checked


def test_the_usual_place_is_the_usual_map() -> None:
    assert stage_at(100) == StageMap()
    assert checked(StageSettings, {}, "stage").first_register == 100


def test_a_block_elsewhere_keeps_its_layout_and_who_answers() -> None:
    beam, usual = stage_at(400), StageMap()
    assert beam.identity == usual.identity
    assert [point.address for point in (beam.motion, beam.x, beam.y, beam.counter)] == [400, 401, 403, 405]
    assert [point.address for point in (beam.target_x, beam.target_y, beam.command, beam.nonce)] == [400, 402, 404, 405]
    assert beam.x.dtype == usual.x.dtype


def test_single_points_may_still_differ() -> None:
    assert overridden(stage_at(400), {"x": {"scale": 1000}}, "stage").x.address == 401


def test_a_block_cannot_lie_on_the_identity() -> None:
    with pytest.raises(BadConfig, match="first_register"):
        checked(StageSettings, {"first_register": 2}, "stage")
