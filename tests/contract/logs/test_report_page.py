"""`semlive report`: one page that needs nothing else, with the figures that the run has data for."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from semlive.formats.log.messages import LogLineMessage, RunMessage, StateMessage
from semlive.report.alarms import alarms_html
from semlive.report.page import refused_html, settings_html
from semlive.report.sections import sections, write_section
from semlive.service.config.overrides import apply_overrides, parse_changes
from semlive.service.log.alarms import Alarm, Alarms
from semlive.service.log.files import segment_path
from semlive.service.log.recording import Recorder
from semlive.service.log.run_facts import LogFacts, RefusedFile
from semlive.service.replay.replay import ReplayRequest, ReplayResult, Source, replay
from semlive.service.runtime.clock import SystemClock

OF_THE_PAPER = {"fig01", "fig05", "fig06", "fig07", "fig10", "fig11", "fig12", "fig13", "fig14", "fig15", "fig16"}


@pytest.fixture(scope="module")
def done(imported: Path) -> ReplayResult:
    return replay(ReplayRequest(imported, source=Source.DISPARITY))


def test_a_tensile_run_has_the_papers_figures(done: ReplayResult) -> None:
    keys = [item.key for item in sections(done.result, None, done.settings)]
    assert {key.split("-")[0] for key in keys if key.startswith("fig")} == OF_THE_PAPER
    assert {"strain-maps", "stress-strain"} <= set(keys)
    assert len(keys) == len(set(keys))


def test_the_page_reports_all_and_needs_nothing(semlive: Callable[..., tuple[int, str, str]], imported: Path, tmp_path: Path) -> None:
    code, printed, err = semlive("report", str(imported), "-o", str(tmp_path / "page.html"), "--json")
    assert (code, json.loads(printed)) == (0, {"page": str(tmp_path / "page.html"), "figures": []}), err
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    headings = re.findall(r"<h2>(.*?)</h2>", page)
    assert {"Uncertainty budget", "Frames", "Alarms", "Refused frames", "Settings", "Versions", "False strain", "Translation path"} <= set(
        headings
    )
    assert page.count('src="data:image/png;base64,') == page.count("<img ") > 10
    assert not re.search(r'(?:src|href)="(?!data:)|url\(|<script', page)
    assert "dic.subset_px" in page
    assert "Young&#x27;s modulus</td><td>" in page


def test_a_page_is_named_after_its_log_and_two_do_not_meet(
    semlive: Callable[..., tuple[int, str, str]], short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for run in ("al2024-1.1", "al2024-1.2"):
        (tmp_path / run).mkdir()
        shutil.copy(short, tmp_path / run / f"{run}.000.mcap")
    monkeypatch.chdir(tmp_path / "al2024-1.2")
    for given in (str(tmp_path / "al2024-1.1"), "."):
        code, _, err = semlive("report", given)
        assert code == 0, err
    pages = sorted(tmp_path.rglob("*.html"))
    assert pages == [tmp_path / "al2024-1.1-report.html", tmp_path / "al2024-1.2-report.html"]
    for page, run in zip(pages, ("al2024-1.1", "al2024-1.2"), strict=True):
        assert re.findall(r"<h1>(.*?)</h1>", page.read_text(encoding="utf-8")) == [run]


def test_the_page_and_the_export_state_the_measure_of_strain(
    semlive: Callable[..., tuple[int, str, str]], done: ReplayResult, imported: Path, tmp_path: Path
) -> None:
    assert "engineering small strain relative to frame 0" in settings_html(done.settings, done.analysis.grid)
    code, _, err = semlive(
        "export", str(imported), "--format", "hdf5", "-o", str(tmp_path / "out.h5"), "--until", "5",
        "--set", "estimate.strain.measure=green_lagrange",
    )  # fmt: skip
    assert code == 0, err
    with h5py.File(tmp_path / "out.h5") as file:
        assert "Green-Lagrange strain, tension positive" in str(file.attrs["conventions"])
    green = apply_overrides(done.settings, parse_changes(["estimate.strain.measure=green_lagrange"]))
    assert "Green-Lagrange strain relative to frame 0" in settings_html(green, done.analysis.grid)


def test_refused_frames_are_counted_by_reason_and_listed() -> None:
    refused = tuple(RefusedFile(k, f"<a{k}>.tif", f"<a{k}>.tif is not used: its scan began {k} s before the hold ended") for k in range(3))
    page = refused_html(LogFacts(files=9, refused=refused))
    assert "3 of 9 files were not used" in page
    assert "<td>is not used: its scan began # s before the hold ended</td><td>3<" in page
    assert "&lt;a2&gt;.tif</td><td>&lt;a2&gt;.tif is not used: its scan began 2 s" in page


def test_alarms_are_listed_and_none_is_reported_only_of_a_log_without_any() -> None:
    open_one = Alarm(1_800_000_000_123_456_789, "emergency_stop", "<emergency stop>", "load frame", "stopped")
    done_one = Alarm(1_800_000_001_999_999_999, "limit", "beyond", "run", "stopped", 1_800_000_002_000_000_000, "page at 127.0.0.1")
    page = alarms_html(Alarms((open_one, done_one)))
    assert "2 alarms, 1 of them not acknowledged" in page
    assert (
        "<td>2027-01-15 08:00:00.123</td><td>danger</td><td>emergency_stop</td><td>load frame</td><td>&lt;emergency stop&gt;</td>" in page
    )
    assert "<td>stopped</td><td>no</td>" in page
    assert "<td>2027-01-15 08:00:01.999</td><td>danger</td><td>limit</td>" in page
    assert "<td>2027-01-15 08:00:02.000 page at 127.0.0.1</td>" in page
    assert alarms_html(Alarms()) == "<p>None.</p>"
    assert "None" not in alarms_html(None)


def test_a_run_without_results_has_a_page_of_its_alarms(semlive: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    clock = SystemClock()
    log, now_ns = tmp_path / "stopped", clock.now_ns()
    log.mkdir()
    recorder = Recorder(segment_path(log, "stopped", 0), clock, lambda _: None)
    recorder.write("/run", RunMessage(run="stopped", started_time_ns=now_ns, host="lab", versions={}, config={"run": {"name": "stopped"}}))
    recorder.write("/state", StateMessage(time_ns=now_ns, before="ramping", after="estopped", cause="emergency", step=0, guards={}))
    recorder.write("/log", LogLineMessage(time_ns=now_ns, level="info", text="the load frame was stopped by its <emergency stop>"))
    assert recorder.close(10.0)
    code, printed, err = semlive("report", str(log))
    assert (code, printed) == (2, "")
    assert err.endswith(f"its alarms and rejected frames are in {tmp_path / 'stopped-report.html'}\n")
    page = (tmp_path / "stopped-report.html").read_text(encoding="utf-8")
    assert "1 alarms, 1 of them not acknowledged" in page
    assert "<td>emergency_stop</td><td>run</td><td>the load frame was stopped by its &lt;emergency stop&gt;</td>" in page
    assert re.findall(r"<h2>(.*?)</h2>", page) == ["Alarms", "Refused frames", "Settings", "Versions"]


def test_a_figure_is_written_for_a_journal(done: ReplayResult, tmp_path: Path) -> None:
    section = next(item for item in sections(done.result, None, done.settings) if item.key == "fig14-constants")
    paths = write_section(tmp_path / "figures", section)
    assert [item.name for item in paths] == ["fig14-constants.png", "fig14-constants.pdf"]
    assert paths[1].read_bytes().startswith(b"%PDF")
    assert png_width(paths[0]) == pytest.approx(7.0 * 300, abs=1)


def png_width(path: Path) -> int:
    """Width of a PNG, from its header."""
    return int.from_bytes(path.read_bytes()[16:20], "big")
