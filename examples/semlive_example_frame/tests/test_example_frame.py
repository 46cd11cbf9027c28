"""semlive's contract for every load frame, with this one; the same few lines serve yours."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from semlive_example_frame.rig import ExampleRig

from semlive_drivers.conformance import CHECKS, Check


@pytest.fixture
def rig() -> Iterator[ExampleRig]:
    made = ExampleRig()
    yield made
    made.end()


@pytest.mark.parametrize("check", CHECKS.values(), ids=CHECKS)
def test_the_contract(rig: ExampleRig, check: Check) -> None:
    check(rig)
