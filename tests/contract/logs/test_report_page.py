"""`semlive report`: one page that needs nothing else, with the figures that the run has data for."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from semlive.data.experiment import Phase
from semlive.errors import BadInput
from semlive.formats.log.messages import LogLineMessage, RunMessage, StateMessage
from semlive.report.document.blocks import (
    Bullets,
    Document,
    FigureBlock,
    KeyFigures,
    Listing,
    Paragraph,
    Table,
    figure_caption,
)
from semlive.report.run_data import MAX_MAP_FRAMES, chosen_frames, log_files, run_data
from semlive.report.run_report import run_report
from semlive.report.sections.appendix import alarm_blocks, refused_blocks, settings_text
from semlive.report.sections.wording import NOT_RECORDED, seconds, with_sigma
from semlive.service.config.overrides import apply_overrides, parse_changes
from semlive.service.log.alarms import Alarm, Alarms
from semlive.service.log.files import segment_path
from semlive.service.log.recording import Recorder
from semlive.service.log.run_facts import LogFacts, RefusedFile
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, ReplayResult, Source, replay
from semlive.service.runtime.clock import SystemClock

OF_THE_PAPER = {"fig01", "fig05", "fig06", "fig07", "fig10", "fig11", "fig12", "fig13", "fig14", "fig15", "fig16"}
STRUCTURE = {
    "Summary": ["KeyFigures", "Paragraph", "Paragraph"],
    "1 Material and instrument": ["Paragraph", "Paragraph", "Paragraph", "Table", "Paragraph"],
    "2 Protocol": ["Paragraph", "Paragraph", "protocol", "Table"],
    "3 Calibration": [
        *4 * ["Paragraph"], "fig05-drift", "fig01-drift-in-frames", "fig10-drift-field", "fig11-distortion", "fig06-pair", "fig07-left",
        "fig15-path", "fig16-false-strain", "fig12-unloaded",
    ],
    "4 Results": ["Paragraph", "stress-strain", "fig14-constants", "fig13-loaded", "displacement-maps", "strain-maps", "Table"],
    "5 Uncertainty budget": ["Paragraph", "Table"],
    "6 Limits and warnings": ["Paragraph", *3 * ["Paragraph", "Bullets"]],
    "Appendix A: Alarms": ["Paragraph"],
    "Appendix B: Refused frames": ["Paragraph"],
    "Appendix C: Settings": ["Paragraph", "Table", "Listing"],
    "Appendix D: Files and versions": ["Table", "Table", "Table"],
}  # fmt: skip
"""Sections of the report of an imported tensile run without images, with the kind of each block, or the key of each figure."""


@pytest.fixture(scope="module")
def done(imported: Path) -> ReplayResult:
    return replay(ReplayRequest(imported, source=Source.DISPARITY), ReplayCallbacks(frame=lambda _: None))


@pytest.fixture(scope="module")
def document(imported: Path, done: ReplayResult) -> Document:
    return run_report(run_data(imported, done))


def text_of(document: Document) -> str:
    """Paragraphs, lists, tables and captions of a report."""
    parts: list[str] = []
    for section in document.sections:
        for block in section.blocks:
            match block:
                case Paragraph(text) | Listing(_, text):
                    parts.append(text)
                case Bullets(items):
                    parts += items
                case Table():
                    parts += [block.caption, *(" | ".join(row) for row in block.rows)]
                case FigureBlock():
                    parts.append(f"{block.title}. {block.caption}")
                case KeyFigures(entries):
                    parts += [f"{label} = {value}" for label, value in entries]
    return "\n".join(parts)


def test_a_report_has_the_structure_of_a_paper_and_the_figures_of_the_method(document: Document) -> None:
    found = {
        section.title: [block.key if isinstance(block, FigureBlock) else type(block).__name__ for block in section.blocks]
        for section in document.sections
    }
    assert found == STRUCTURE
    keys = [block.key for _, block in document.figures()]
    assert {key.split("-")[0] for key in keys if key.startswith("fig")} == OF_THE_PAPER
    assert len(keys) == len(set(keys))


def test_the_text_states_the_numbers_of_the_log(document: Document, done: ReplayResult) -> None:
    text, elastic, first = text_of(document), done.result.elastic, done.result.decisions[0].first
    assert elastic is not None
    modulus, ratio = elastic.youngs_modulus_gpa, elastic.poissons_ratio
    assert f"E = {with_sigma(modulus.value, modulus.sigma, 'GPa')}" in text
    assert f"ν = {with_sigma(ratio.value, ratio.sigma)}" in text
    loads = [decision.step.load_n for decision in done.result.decisions if decision.step.load_n is not None]
    assert f"loaded in {len(loads)} steps from {min(loads):g} N to {max(loads):g} N" in text
    assert f"dwell time | {seconds(first.timing.dwell_time_s.value)} |" in text
    last = done.result.summaries[-1]
    assert f"{last.frame} | tension | {done.result.decisions[-1].loads[1].mean_n:.1f} |" in text  # type: ignore[index]
    assert f"{1e6 * last.mean.eyy:.1f} ± {1e6 * last.mean_sigma.eyy:.1f}" in text


def test_what_the_log_does_not_have_is_named_and_not_invented(document: Document) -> None:
    text = text_of(document)
    for quantity in ("detector", "acceleration voltage", "magnification, by the convention of the maker", "working distance"):
        assert f"{quantity} | {NOT_RECORDED} | -" in text
    assert f"material of the specimen is {NOT_RECORDED}" in text
    assert "holds no readable SEM image" in text
    assert "The uncertainty of the cross-section" in text


def test_captions_stand_alone(document: Document) -> None:
    for number, block in document.figures():
        caption = figure_caption(number, block)
        assert len(caption.split()) > 15, caption
        assert caption.endswith("."), caption
        assert "As Fig." not in caption
        labels = [label for axes in block.figure.axes for label in (axes.get_xlabel(), axes.get_ylabel())]
        assert any("(" in label for label in labels), f"{block.key} has no axis with a unit"
        assert any(axes.get_xlabel() for axes in block.figure.axes), block.key


def test_maps_are_of_load_steps_or_of_chosen_frames(done: ReplayResult) -> None:
    loaded = [2 * decision.pair + 1 for decision in done.result.decisions if decision.step.phase is Phase.TENSION]
    chosen = chosen_frames(done.result)
    assert len(chosen) == MAX_MAP_FRAMES
    assert set(chosen) <= set(loaded)
    assert (chosen[0], chosen[-1]) == (loaded[0], loaded[-1])
    assert chosen_frames(done.result, (3, 5)) == (3, 5)
    for wrong in ((999,), (1, 2, 3, 4, 5)):
        with pytest.raises(BadInput, match="--maps: give at most 4 numbers of frames between 0 and"):
            chosen_frames(done.result, wrong)


def test_files_of_the_log_have_their_checksums(imported: Path) -> None:
    (file,) = log_files(imported)
    content = imported.read_bytes()
    assert (file.name, file.size, file.sha256) == (imported.name, len(content), hashlib.sha256(content).hexdigest())


def test_the_page_reports_all_and_needs_nothing(semlive: Callable[..., tuple[int, str, str]], imported: Path, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    code, printed, err = semlive("report", str(imported), "-o", str(path), "--json")
    assert (code, json.loads(printed)) == (0, {"page": str(path), "figures": [], "pdf": None}), err
    page = path.read_text(encoding="utf-8")
    assert re.findall(r"<h2[^>]*>(.*?)</h2>", page) == list(STRUCTURE)
    assert page.count('src="data:image/svg+xml,') == page.count("<img ") == page.count("<figcaption>") > 10
    assert not re.search(r'(?:src|href)="(?!data:|#)|url\(|<script', page)
    assert "dic.subset_px" in page
    assert "Young&#x27;s modulus</td><td>" in page


def test_a_page_is_named_after_its_log_and_two_do_not_meet(
    semlive: Callable[..., tuple[int, str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for run in ("al2024-1.1", "al2024-1.2"):
        stopped_run(tmp_path / run)
    monkeypatch.chdir(tmp_path / "al2024-1.2")
    for given in (str(tmp_path / "al2024-1.1"), "."):
        code, _, err = semlive("report", given)
        assert code == 2, err
    pages = sorted(tmp_path.rglob("*.html"))
    assert pages == [tmp_path / "al2024-1.1-report.html", tmp_path / "al2024-1.2-report.html"]
    for page, run in zip(pages, ("al2024-1.1", "al2024-1.2"), strict=True):
        assert re.findall(r"<h1>(.*?)</h1>", page.read_text(encoding="utf-8")) == [run]


def test_the_page_and_the_export_state_the_measure_of_strain(
    semlive: Callable[..., tuple[int, str, str]], done: ReplayResult, imported: Path, tmp_path: Path
) -> None:
    assert "engineering small strain relative to frame 0" in settings_text(done.settings, done.analysis.grid)
    code, _, err = semlive(
        "export", str(imported), "--format", "hdf5", "-o", str(tmp_path / "out.h5"), "--until", "5",
        "--set", "estimate.strain.measure=green_lagrange",
    )  # fmt: skip
    assert code == 0, err
    with h5py.File(tmp_path / "out.h5") as file:
        assert "Green-Lagrange strain, tension positive" in str(file.attrs["conventions"])
    green = apply_overrides(done.settings, parse_changes(["estimate.strain.measure=green_lagrange"]))
    assert "Green-Lagrange strain relative to frame 0" in settings_text(green, done.analysis.grid)


def test_refused_frames_are_counted_by_reason_and_listed() -> None:
    refused = tuple(RefusedFile(k, f"<a{k}>.tif", f"<a{k}>.tif is not used: its scan began {k} s before the hold ended") for k in range(3))
    summary, reasons, listed = refused_blocks(LogFacts(files=9, refused=refused))
    assert summary == Paragraph("3 of 9 files were not used.")
    assert isinstance(reasons, Table)
    assert isinstance(listed, Table)
    assert reasons.rows == (("is not used: its scan began # s before the hold ended", "3"),)
    assert listed.rows[2] == ("2", "<a2>.tif", "<a2>.tif is not used: its scan began 2 s before the hold ended")


def test_alarms_are_listed_and_none_is_reported_only_of_a_log_without_any() -> None:
    open_one = Alarm(1_800_000_000_123_456_789, "emergency_stop", "<emergency stop>", "load frame", "stopped")
    done_one = Alarm(1_800_000_001_999_999_999, "limit", "beyond", "run", "stopped", 1_800_000_002_000_000_000, "page at 127.0.0.1")
    summary, table = alarm_blocks(Alarms((open_one, done_one)))
    assert summary == Paragraph("2 alarms, 1 of them not acknowledged.")
    assert isinstance(table, Table)
    assert table.rows[0] == (
        "2027-01-15 08:00:00.123", "danger", "emergency_stop", "load frame", "<emergency stop>", "stopped", "no",
    )  # fmt: skip
    assert table.rows[1][:4] == ("2027-01-15 08:00:01.999", "danger", "limit", "run")
    assert table.rows[1][6] == "2027-01-15 08:00:02.000 page at 127.0.0.1"
    assert alarm_blocks(Alarms()) == (Paragraph("None."),)
    assert "None" not in str(alarm_blocks(None))


def stopped_run(log: Path) -> None:
    """A run that was stopped before its first pair."""
    clock = SystemClock()
    now_ns = clock.now_ns()
    log.mkdir()
    recorder = Recorder(segment_path(log, log.name, 0), clock, lambda _: None)
    recorder.write("/run", RunMessage(run=log.name, started_time_ns=now_ns, host="lab", versions={}, config={"run": {"name": log.name}}))
    recorder.write("/state", StateMessage(time_ns=now_ns, before="ramping", after="estopped", cause="emergency", step=0, guards={}))
    recorder.write("/log", LogLineMessage(time_ns=now_ns, level="info", text="the load frame was stopped by its <emergency stop>"))
    assert recorder.close(10.0)


def test_a_run_without_results_has_a_page_of_its_alarms(semlive: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    log = tmp_path / "stopped"
    stopped_run(log)
    code, printed, err = semlive("report", str(log))
    assert (code, printed) == (2, "")
    assert err.endswith(f"its alarms and rejected frames are in {tmp_path / 'stopped-report.html'}\n")
    page = (tmp_path / "stopped-report.html").read_text(encoding="utf-8")
    assert "1 alarms, 1 of them not acknowledged" in page
    assert "<td>emergency_stop</td><td>run</td><td>the load frame was stopped by its &lt;emergency stop&gt;</td>" in page
    assert re.findall(r"<h2[^>]*>(.*?)</h2>", page) == ["Summary", "Alarms", "Refused frames", "Settings", "Versions"]


def test_wrong_numbers_of_frames_are_refused_before_the_work(semlive: Callable[..., tuple[int, str, str]], imported: Path) -> None:
    code, _, err = semlive("report", str(imported), "-o", str(imported.with_name("no.html")), "--maps", "3;5")
    assert code == 2
    assert "--maps 3;5: give numbers of frames with commas between them" in err
    assert not imported.with_name("no.html").exists()
