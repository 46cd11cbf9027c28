"""A rehearsal moves simulated machines only."""

from __future__ import annotations

import pytest

from semlive.errors import BadConfig, SemliveError
from semlive_drivers import null
from semlive_drivers.operator.load_frame import open_load_frame
from semlive_drivers.operator.rehearsal import RehearsedLoadFrame, RehearsedStage
from semlive_drivers.operator.stage import open_stage

from ...clocks import MonotonicClock


def test_answers_never_move_a_real_load_frame() -> None:
    with pytest.raises(BadConfig, match="is a real machine, which answers must not move"):
        RehearsedLoadFrame(open_load_frame({}, MonotonicClock()), null.open_load_frame({}, MonotonicClock()))


def test_answers_never_move_a_real_stage() -> None:
    with pytest.raises(BadConfig, match="is a real machine, which answers must not move"):
        RehearsedStage(open_stage({}, MonotonicClock()), null.open_stage({}, MonotonicClock()))


def test_a_rehearsal_needs_a_device_that_answers() -> None:
    with pytest.raises(SemliveError, match=r"127\.0\.0\.1"):
        open_stage({"rehearsal": {"host": "127.0.0.1", "port": 9, "unit": 1}}, MonotonicClock())
