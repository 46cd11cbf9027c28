"""What long jobs say of the time that is left."""

from __future__ import annotations

import pytest

from semlive.cli.progress import Pace


def test_a_run_takes_as_long_for_each_step_as_before() -> None:
    pace = Pace()
    assert pace.left_s(0, 5, 100.0) is None
    assert pace.left_s(0, 5, 105.0) is None
    assert pace.left_s(1, 5, 110.0) == pytest.approx(40.0)
    assert pace.left_s(1, 5, 116.0) == pytest.approx(34.0)
    assert pace.left_s(2, 5, 130.0) == pytest.approx(45.0)
    assert pace.left_s(2, 5, 300.0) == 0.0


def test_a_run_that_was_taken_up_again_knows_only_its_own_steps() -> None:
    pace = Pace()
    assert pace.left_s(7, 10, 0.0) is None
    assert pace.left_s(8, 10, 20.0) == pytest.approx(40.0)
