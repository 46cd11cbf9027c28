"""The short demo as a user runs it: one command, its table, its bars; then its log scored against its truth."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

import semlive
from semlive.cli.app import app
from semlive.service.log.files import messages

sys.path.insert(0, str(Path(__file__).parents[1] / "conventions"))
sys.path.insert(0, str(Path(__file__).parents[1] / "golden"))
from json_keys import RECORDED, commands, printed
from read_by_others import check_layout, check_messages, counts
from run_notebook import run_notebook
from shown import CASES, ON_A_LOG
from sidebyside.facts import DISTORTION_BAR_PX, PAPER, QUICK_WINDOWS
from sidebyside.measure import measure
from sidebyside.table import Row, rows

from ..waiting import RUN_END_S

SHORTER = {"replay": ["--from-disparity"], "simulate": ["--frames", "0"]}
"""So that the complete demo takes half a minute; with images and all frames the tutorial and test_cli_simulate do it."""
SLOW = re.compile(r"diagnose|experiment decide|replay.* --model|report|simulate.* --from|.* (?:my-|runs/|test\.tif)")
"""Run from top to bottom of the tutorial and of the first experiment, of short logs in test_cli_diagnose, or by test_pages."""
PAGES = Path(__file__).parents[2] / "docs"
NOTEBOOK = PAGES / "examples" / "analyse_a_log.ipynb"
GOLDEN = Path(__file__).parents[1] / "golden" / "score_names.json"


@dataclass(frozen=True)
class Demo:
    """A finished run and its output."""

    folder: Path
    printed_text: str
    printed_json: dict[str, Any]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    folder = tmp_path_factory.mktemp("short") / "demo"
    done = subprocess.run(
        [sys.executable, "-m", "semlive", "demo", "--short", "--json", "--out", str(folder)],
        capture_output=True,
        text=True,
        timeout=RUN_END_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return Demo(folder, " ".join(done.stderr.split()), json.loads(done.stdout))


def test_the_short_demo_runs_to_its_table(demo: Demo) -> None:
    for words in ("recovered and true values", "Young's modulus", "Poisson's ratio", "report.html"):
        assert words in demo.printed_text
    scores = json.loads((demo.folder / "score.json").read_text(encoding="utf-8"))
    paths = {"folder": str(demo.folder), "log": str(demo.folder / "log" / "demo"), "report": str(demo.folder / "report.html")}
    assert demo.printed_json == {**paths, "score": scores}
    assert abs(scores["Young's modulus"]["error"]) < 0.03 * 71.1
    assert abs(scores["Poisson's ratio"]["error"]) < 0.02
    assert scores["drift within the worst frame, rms error"]["value"] < 0.02
    assert scores["mean strain, calibration, the worst of 9 frames"]["value"] < 30.0
    assert (demo.folder / "report.html").stat().st_size > 100_000
    live = [json.loads(message.payload) for message in messages(demo.folder / "log" / "demo") if message.topic == "/result"]
    assert [one["pairs"] for one in live] == [9]


def test_an_open_log_gives_the_exported_images(demo: Demo) -> None:
    log = semlive.open_log(demo.folder / "log" / "demo")
    image = log.image(3)
    exported = [tifffile.imread(path)[: image.shape[0]] for path in (demo.folder / "instrument" / "export").glob("*.tif")]
    assert sum(np.array_equal(image, other) for other in exported) == 1
    assert log.pixel_size_um == pytest.approx(1.25, rel=0.01)


@pytest.mark.checkout
def test_the_notebook_lays_a_map_over_its_image(demo: Demo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SEMLIVE_LOG", "")  # restored after the test
    names, _ = run_notebook(NOTEBOOK, demo.folder / "log" / "demo")
    (image,) = names["figure"].axes[0].images
    assert image.get_array().shape == names["log"].image(0).shape


def test_others_read_its_log_and_every_panel_of_the_layout_shows_something(demo: Demo) -> None:
    path = demo.folder / "log" / "demo" / "demo.000.mcap"
    newest = check_messages(path)
    assert newest["/state"]["boot_id"] == newest["/run"]["boot_id"]
    assert newest["/state"]["mono_ns"] > 0
    assert newest["/load_frame/sample"]["rtt_s"] > 0.0
    assert check_layout(newest, set(counts(path))) >= 8


@pytest.mark.checkout
@pytest.mark.parametrize(("page", "which"), [("tutorials/first-run.md", ".*"), ("how-to/first-experiment.md", ".* runs/al2024-01.*")])
def test_what_a_page_does_with_a_run_can_be_done(
    page: str, which: str, demo: Demo, tmp_path: Path, semlive: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "first").symlink_to(demo.folder)
    (tmp_path / "runs" / "al2024-01").symlink_to(demo.folder / "log" / "demo")
    lines = re.findall(rf"^ {{4}}semlive ({which})$", (PAGES / page).read_text(encoding="utf-8"), re.MULTILINE)
    assert len(lines) >= 2
    for line in lines:
        code, _, err = semlive(*line.split())
        assert code == 0, f"{line}: {err}"


@pytest.mark.checkout
def test_what_the_pages_show_can_be_done_with_its_log(demo: Demo, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    log, (first, second, *_) = demo.folder / "log" / "demo", sorted((demo.folder / "instrument" / "export").glob("*.tif"))
    places = {"LOG": log, "FILE": first, "REF": first, "CUR": second, "SCENARIO": "short", "CONFIG": demo.folder / "run.yaml"}
    places |= {
        "TRUTH": demo.folder / "instrument" / "truth.json",
        "WITHOUT": log,
        "WITH": log,
        "hdf5|csv|mat|vtk|vtu|png|nexus|ro-crate": "hdf5",
    }
    command_lines = [line for _, line in CASES if line.split()[0] in ON_A_LOG and re.search(r" (?:LOG|FILE|REF|CONFIG|SCENARIO)\b", line)]
    typed: dict[tuple[str, ...], str] = {}
    for line in (one for one in command_lines if not SLOW.match(one)):
        name, *given = shlex.split(line)
        words = [str(places.get(word.rstrip("."), word)) for word in given]
        words += ["--format", "hdf5"] if name == "export" and "--format" not in words else []
        words += ["-o", "OUT"] if name == "export" and "-o" not in words else []
        typed.setdefault((name, *words, *SHORTER.get(name, [])), line)
    for number, (words, line) in enumerate(typed.items()):
        ran = CliRunner().invoke(app, [f"out{number}" if word in ("OUT", "FOLDER") else word for word in words])
        assert ran.exit_code == 0, f"{line}: {ran.output} {ran.exception}"
    done = {"diagnose", "report", *(words[0] for words in typed)}
    assert done == set(ON_A_LOG)


@pytest.fixture(scope="module")
def scored(demo: Demo) -> dict[str, dict[str, Any]]:
    """What ``semlive score --json`` prints."""
    log, truth = demo.folder / "log" / "demo", demo.folder / "instrument" / "truth.json"
    figures = demo.folder / "figures"
    done = CliRunner().invoke(app, ["score", str(log), "--truth", str(truth), "--json", "--figures", str(figures)])
    assert done.exit_code == 0, f"{done.output} {done.exception}"
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
    """Coverage of many points within its bounds; few frames share few errors, so their coverage has a larger uncertainty."""
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
    figures = measure(demo.folder, QUICK_WINDOWS)
    found: dict[str, Row] = {row.quantity: row for row in rows(figures, PAPER["paper_x200"])}
    bars = {name: row.held for name, row in found.items() if row.held is not None}
    assert len(bars) >= 8
    shaky = {"Young's modulus", "Poisson's ratio"}  # four load steps: three times the uncertainty of the full experiment
    residual = "distortion residual, its affine part removed"
    assert not [found[name].markdown() for name, held in bars.items() if not held and name not in (*shaky, residual)]
    # Five pairs determine the corners of the field to 0.011 px. Which frames they are, and so which noise, depends on the computer's speed:
    # 84, 88 and 95 % of the field were determined well enough for the bar.
    distortion = figures.errors.distortion
    error_px, sigma_px = np.abs(distortion.error_px[distortion.valid]).max(axis=-1), distortion.sigma_px[distortion.valid]
    decided = 4.0 * sigma_px < DISTORTION_BAR_PX
    assert decided.mean() > 0.75
    assert error_px[decided].max() <= DISTORTION_BAR_PX
    assert (error_px / sigma_px).max() < 4.5


def test_every_recorded_json_key_is_still_printed(demo: Demo) -> None:
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))
    for name, arguments in commands(demo.folder).items():
        output = CliRunner().invoke(app, arguments).stdout
        missing = sorted(set(recorded.pop(name)) - set(printed(output)))
        assert missing == [], f"semlive {name}: keys are missing"
    assert recorded == {}
