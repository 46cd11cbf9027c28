"""The entry point, before any command is imported."""

from __future__ import annotations

import os
import sys

import pytest

from semlive.cli.main import main


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
