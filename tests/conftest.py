"""What holds for every test."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from semlive.service.runtime.blas import limit_blas_threads

# How long an example takes by the wall says how busy the computer is; where it matters a test counts its own processor time.
settings.register_profile("semlive", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("semlive")


@pytest.fixture(scope="session", autouse=True)
def sums_in_one_order() -> None:
    """As in every analysis; choices that lie close together may fall otherwise with sums in another order."""
    limit_blas_threads()


WAITING = ("scenario/test_daemon", "scenario/test_demo", "scenario/test_bench", "fault/", "browser/", "contract/links/")
"""Tests that mostly wait for simulated machines in real time; the others compute."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With several processes, distribute the files that wait evenly over the run, so that waiting and computing overlap."""
    if not hasattr(config, "workerinput"):
        return
    root = Path(__file__).parent
    files = [list(tests) for _, tests in groupby(items, key=lambda item: item.path)]
    ranked: list[tuple[float, list[pytest.Item]]] = []
    for waits in (True, False):
        kind = [tests for tests in files if tests[0].path.relative_to(root).as_posix().startswith(WAITING) is waits]
        ranked += [((number + 0.5) / len(kind), tests) for number, tests in enumerate(kind)]
    items[:] = [test for _, tests in sorted(ranked, key=lambda entry: entry[0]) for test in tests]
