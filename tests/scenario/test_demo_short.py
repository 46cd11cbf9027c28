"""The short demo as a user runs it: one command, its table, its bars; then its log scored against its truth."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from semlive.service.log_files import messages

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from sidebyside.facts import PAPER, QUICK_WINDOWS
from sidebyside.measure import measure
from sidebyside.table import Row, rows

GOLDEN = Path(__file__).parents[1] / "golden" / "score_names.json"


@dataclass(frozen=True)
class Demo:
    """A finished run and what it said."""

    folder: Path
    said: str


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    folder = tmp_path_factory.mktemp("short") / "demo"
    done = subprocess.run(
        [sys.executable, "-m", "semlive", "demo", "--short", "--out", str(folder)], capture_output=True, text=True, timeout=550, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return Demo(folder, " ".join(done.stdout.split()))


@pytest.mark.timeout(600)
def test_the_short_demo_runs_to_its_table(demo: Demo) -> None:
    for words in ("recovered against true", "Young's modulus", "Poisson's ratio", "report.html"):
        assert words in demo.said
    scores = json.loads((demo.folder / "score.json").read_text(encoding="utf-8"))
    assert abs(scores["Young's modulus"]["error"]) < 0.03 * 71.1
    assert abs(scores["Poisson's ratio"]["error"]) < 0.02
    assert scores["drift within the worst frame, rms error"]["value"] < 0.02
    assert scores["mean strain, calibration, the worst of 9 frames"]["value"] < 30.0
    assert (demo.folder / "report.html").stat().st_size > 100_000
    live = [json.loads(message.payload) for message in messages(demo.folder / "log" / "demo") if message.topic == "/result"]
    assert [one["pairs"] for one in live] == [9]


@pytest.fixture(scope="module")
def scored(demo: Demo) -> dict[str, dict[str, Any]]:
    """What ``semlive score --json`` prints."""
    log, truth = demo.folder / "log" / "demo", demo.folder / "instrument" / "truth.json"
    figures = demo.folder / "figures"
    done = subprocess.run(
        [sys.executable, "-m", "semlive", "score", str(log), "--truth", str(truth), "--json", "--figures", str(figures)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(list(figures.glob("score-*.png"))) == 4
    return json.loads(done.stdout)


def test_the_score_keeps_its_contract(scored: dict[str, dict[str, Any]]) -> None:
    """Names are only added, each with the promised keys."""
    missing = [name for name in json.loads(GOLDEN.read_text(encoding="utf-8")) if name not in scored]
    assert not missing
    for name, one in scored.items():
        assert set(one) >= {"truth", "value", "sigma", "error", "unit", "inside68", "inside95"}, name
        assert all(isinstance(one[key], float) for key in ("truth", "value", "sigma", "error")), name
        assert one["error"] == pytest.approx(one["value"] - one["truth"])
        assert isinstance(one["inside68"], bool)
        assert one["inside95"] or not one["inside68"], name
        assert one["sigma"] > 0, name


def test_stated_uncertainties_are_about_right(scored: dict[str, dict[str, Any]]) -> None:
    """Coverage of many points within what it should be; few frames share few errors, so their coverage says less."""
    for name, bound in (
        ("displacement of points", 0.04),
        ("distortion", 0.3),
        ("drift within frames", 0.3),
        ("mean strain of frames", 0.35),
    ):
        assert abs(scored[f"coverage at 68 %, {name}"]["error"]) < bound, name
    outside = [name for name, one in scored.items() if not one["inside95"]]
    # One wrong drift rate is in the rows of six frames and in the shifts of all pairs after it.
    assert len(outside) < 0.25 * len(scored), outside


def test_the_paper_is_matched_in_what_a_short_run_can_show(demo: Demo) -> None:
    found: dict[str, Row] = {row.quantity: row for row in rows(measure(demo.folder, QUICK_WINDOWS), PAPER["paper_x200"])}
    bars = {name: row.held for name, row in found.items() if row.held is not None}
    assert len(bars) >= 8
    shaky = {"Young's modulus", "Poisson's ratio"}  # four load steps: three times the uncertainty of the full experiment
    assert not [found[name].markdown() for name, held in bars.items() if not held and name not in shaky]
