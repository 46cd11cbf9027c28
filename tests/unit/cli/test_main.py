"""The entry point, before any command is imported."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from semlive.cli.main import main

STARTED = """
import gc, runpy, sys
gc.disable()
module, sys.argv = sys.argv[1], sys.argv[1:]
try:
    runpy.run_module(module, run_name="__main__", alter_sys=True)
except SystemExit:
    print(gc.isenabled(), gc.get_freeze_count() > 10_000)
"""


@pytest.fixture(autouse=True)
def garbage_is_collected_again() -> Iterator[None]:
    """A process that only prints ends without."""
    yield
    gc.enable()


@pytest.mark.parametrize(("before", "after"), [(None, "1"), ("4", "4")])
def test_linear_algebra_is_loaded_with_one_thread_unless_the_user_sets_another_number(
    before: str | None, after: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", before or "1")
    if before is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    monkeypatch.setattr(sys, "argv", ["semlive", "--version"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == after


@pytest.mark.parametrize("started", [("semlive", "run"), ("semlive.web",), ("semlive.service.analysis.worker",)], ids=" ".join)
def test_garbage_is_collected_after_the_imports(started: tuple[str, ...]) -> None:
    """Programs that run for weeks; each prints its help, the first thing after its imports."""
    command = [sys.executable, "-c", STARTED, *started, "--help"]
    printed = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, timeout=60).stdout
    assert printed.splitlines()[-1] == "True True"
