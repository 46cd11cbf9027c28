"""The short demo as a user runs it: one command, its table, its bars."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from semlive.service.log_files import messages


@pytest.mark.timeout(600)
def test_the_short_demo_runs_to_its_table(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    done = subprocess.run(
        [sys.executable, "-m", "semlive", "demo", "--short", "--out", str(folder)], capture_output=True, text=True, timeout=550, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for words in ("recovered against true", "Young's modulus", "Poisson's ratio", "report.html"):
        assert words in " ".join(done.stdout.split())
    scores = json.loads((folder / "score.json").read_text(encoding="utf-8"))
    assert abs(scores["Young's modulus"]["error"]) < 0.03 * 71.1
    assert abs(scores["Poisson's ratio"]["error"]) < 0.02
    assert scores["drift within the worst frame, rms error"]["value"] < 0.02
    assert scores["mean strain, calibration, the worst of 9 frames"]["value"] < 30.0
    assert (folder / "report.html").stat().st_size > 100_000
    live = [json.loads(message.payload) for message in messages(folder / "log" / "demo") if message.topic == "/result"]
    assert [one["pairs"] for one in live] == [9]
