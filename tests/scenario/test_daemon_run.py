"""A complete run of the real daemon on a small bench, and the content of its log."""

from __future__ import annotations

import itertools
import json
import re
import subprocess
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from mcap.reader import make_reader

from semlive.estimate.joint.solution.solver import selection_due
from semlive.formats.log.foxglove import SEM_IMAGE
from semlive.formats.log.maps import decode_displacement, decode_strain
from semlive.formats.log.messages import DISPLACEMENT_FIELD, STRAIN_FIELD
from semlive.formats.log.reader import LogMessage
from semlive.report.campaign import process_pool, reanalyse
from semlive.service.analysis.messages import INPUT_TOPICS
from semlive.service.analysis.pipe import AnalysisReady, Heartbeat, read_message
from semlive.service.analysis.result_json import result_json
from semlive.service.analysis.step import WorkerState, process_message
from semlive.service.config.overrides import parse_changes
from semlive.service.log.files import messages
from semlive.service.replay.replay import ReplayRequest, Source, replay
from semlive.service.storage.map_store import MapStore

from ..waiting import RUN_END_S

Command = Callable[..., tuple[int, str, str]]
PX, BOTH = 5, 2


@pytest.fixture(scope="module")
def finished(instrument: Callable[..., Any]) -> Any:
    one = instrument("whole")
    one.wait_for_slow_answers()
    code, printed = one.run()
    one.end_bench()
    assert code == 0, printed
    assert "Traceback" not in printed
    return one


def logged(log: Path, topic: str) -> list[dict[str, Any]]:
    (segment,) = log.glob("*.mcap")
    with segment.open("rb") as stream:
        return [json.loads(message.data) for _, _, message in make_reader(stream).iter_messages(topics=[topic])]


def test_the_log_opens_with_the_library_s_own_reader_and_holds_every_frame_s_timing(finished: Any) -> None:
    scans, pairs = logged(finished.log, "/sem/scan"), logged(finished.log, "/pair")
    assert len(pairs) == PX
    by_export = {scan["export"]: scan for scan in scans}
    for pair in pairs:
        for member, info in enumerate((pair["first"], pair["second"])):
            scan = by_export[info["export"]]
            for name in ("dwell_time_s", "row_time_s", "frame_time_s", "start_time_ns"):
                assert scan[name]["source"] in ("file", "derived")
            assert scan["row_time_s"]["value"] == pytest.approx(9.4 / 276, rel=1e-6)
            assert scan["dwell_time_s"]["value"] == 1e-4
            assert abs(scan["load_before_n"] - pair["loads"][member]["before_n"]) < 1e-9
            assert scan["load_after_n"] is not None


def test_live_and_replayed_results_agree(finished: Any, semlive: Command) -> None:
    (live,) = logged(finished.log, "/result")
    code, out, err = semlive("replay", finished.log, "--json")
    assert (code, json.loads(out)) == (0, live), err
    assert live["pairs"] == PX
    assert len(live["frames"]) == PX * BOTH
    modulus = live["elastic"]["youngs_modulus_gpa"]
    # A frame a tenth as large as the paper's determines the modulus to some 3 %; its stated uncertainty must agree.
    assert modulus["sigma"] < 4.0
    assert abs(modulus["value"] - 71.1) < 4.0 * modulus["sigma"]


def test_a_replay_from_the_log_s_maps_is_the_live_result_to_the_last_bit(finished: Any) -> None:
    (live,) = logged(finished.log, "/result")
    done = replay(ReplayRequest(finished.log, source=Source.DISPARITY))
    assert done.unchanged
    assert done.recorded == live
    assert json.dumps(result_json(done.result, done.settings), sort_keys=True) == json.dumps(live, sort_keys=True)


def test_a_replay_from_images_that_keeps_nothing_in_memory_is_the_live_result_too(finished: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (live,) = logged(finished.log, "/result")
    monkeypatch.setattr("semlive.service.replay.replay.MapStore", lambda: MapStore(in_memory_bytes=0))
    done = replay(ReplayRequest(finished.log, source=Source.IMAGES))
    assert json.dumps(result_json(done.result, done.settings), sort_keys=True) == json.dumps(live, sort_keys=True)


def test_the_first_pairs_are_the_same_from_images_and_from_maps(finished: Any) -> None:
    from_images, from_maps = (replay(ReplayRequest(finished.log, source=source, until=2)) for source in Source)
    assert len(from_images.result.decisions) == len(from_maps.result.decisions) == 3
    assert result_json(from_images.result, from_images.settings) == result_json(from_maps.result, from_maps.settings)


def test_a_log_s_pairs_correlated_by_two_processes_are_the_live_result(finished: Any, tmp_path: Path) -> None:
    (live,) = logged(finished.log, "/result")
    (done,) = reanalyse([ReplayRequest(finished.log)], tmp_path / "out", lambda: process_pool(2))
    assert done.error is None
    assert json.dumps(done.result, sort_keys=True) == json.dumps(live, sort_keys=True)


def test_another_subset_needs_the_images(finished: Any) -> None:
    done = replay(ReplayRequest(finished.log, changes=parse_changes(["dic.subset=31"]), until=1))
    assert result_json(done.result, done.settings)["vsg_px"] == 8 * 8 + 31


def test_a_replay_by_another_method_reports_it(finished: Any, semlive: Command) -> None:
    code, out, err = semlive("replay", finished.log, "--json", "--method", "sutton2007")
    assert code == 0, err
    printed = json.loads(out)
    (live,) = logged(finished.log, "/result")
    assert (live["method"], printed["method"]) == ("joint", "sutton2007")
    assert len(printed["frames"]) == len(live["frames"])


def test_the_strain_gage_goes_from_its_register_to_the_comparison_with_dic(finished: Any) -> None:
    samples, pairs = logged(finished.log, "/load_frame/sample"), logged(finished.log, "/pair")
    assert all(one["gage_strain"] is not None for one in samples)
    (live,) = logged(finished.log, "/result")
    compared = live["strain_gage"]
    assert [one["pair"] for one in compared["steps"]] == [3, 4]
    # The scenario's gage reports 1.005 times the strain. Relative errors of ten readings a frame: 6e-4 (load 500 N), 7e-4 (strain 7e-4).
    modulus, ratio = compared["youngs_modulus_gpa"], compared["dic_over_gage"]
    assert modulus["value"] == pytest.approx(71.1 / 1.005, rel=4e-3)
    assert abs(ratio["value"] - 1.0 / 1.005) < 4.0 * ratio["sigma"]
    for pair, frame in ((pair, frame) for pair in pairs for frame in live["frames"] if frame["pair"] == pair["pair"]):
        assert frame["gage_strain"] == pair["loads"][frame["frame"] % 2]["gage_strain"]


def analysed_again(log: Path) -> list[LogMessage]:
    """What the analysis process makes of a log when it has to catch up from it."""
    count = sum(message.topic in INPUT_TOPICS for message in messages(log))
    command = [sys.executable, "-m", "semlive.service.analysis.worker", "--log", str(log), "--inputs", str(count)]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=RUN_END_S, check=True)
    stream, outputs = BytesIO(done.stdout), []
    while (message := read_message(stream)) is not None:
        if not isinstance(message, Heartbeat):
            outputs.append(message.line if isinstance(message, AnalysisReady) else message)
    return outputs


def test_the_log_holds_the_fields_of_every_frame_and_analysing_again_gives_the_same(finished: Any) -> None:
    topics, outputs = (DISPLACEMENT_FIELD, STRAIN_FIELD), analysed_again(finished.log)
    recorded = {topic: [message for message in messages(finished.log) if message.topic == topic] for topic in topics}
    for topic, live in recorded.items():
        # For each frame of each pair, each under its frame's number: 0 and 1, then 2 and 3, ...; again where a later pair moved it.
        assert list(dict.fromkeys(message.sequence for message in live)) == list(range(PX * BOTH))
        again = [(one.sequence, one.publish_time_ns, one.payload) for one in outputs if one.topic == topic]
        assert [(one.sequence, one.publish_time_ns, one.payload) for one in live] == again
    summaries = {one["frame"]: one for one in logged(finished.log, "/strain/summary")}
    last = [{message.sequence: message for message in live}.values() for live in recorded.values()]
    for moved, strained in zip(*last, strict=True):
        displacement, strain = decode_displacement(moved.payload), decode_strain(strained.payload)
        assert displacement.frame == strain.frame == moved.sequence == strained.sequence
        assert displacement.grid == strain.grid
        assert displacement.valid.mean() > 0.9
        sd = summaries[strain.frame]["sd"]
        for name in ("exx", "eyy", "exy"):
            assert getattr(strain, name)[strain.valid].std() == pytest.approx(sd[name], rel=1e-6)


def test_a_pair_named_long_after_its_frames_were_read_still_has_them(finished: Any) -> None:
    inputs = [message for message in messages(finished.log) if message.topic in INPUT_TOPICS]
    early = [message for message in inputs if message.topic != "/pair"]
    late = next(message for message in inputs if message.topic == "/pair")
    state, outputs = WorkerState(), ()
    for message in early:
        state, _ = process_message(state, message)
    assert len(state.frames) > 8
    _, outputs = process_message(state, late)
    assert any(message.topic == STRAIN_FIELD for message in outputs)


def test_a_pair_is_reported_before_the_review_that_it_makes_due(finished: Any) -> None:
    """Every estimate has its own revision; after 1, 2, 3, 4, 6, ... pairs a second one follows, and no map or picture waits for it."""
    outputs = [one for one in messages(finished.log) if one.topic in ("/dic/summary", "/drift/estimate", SEM_IMAGE)]
    drifts = [json.loads(one.payload) for one in outputs if one.topic == "/drift/estimate"]
    pairs = len(logged(finished.log, "/pair"))
    assert [one["revision"] for one in drifts] == list(range(1, len(drifts) + 1))
    pair_counts = [one["pairs"] for one in drifts]
    assert sorted(set(pair_counts)) == list(range(1, pairs + 1))
    assert [pair_counts.count(number) for number in range(1, pairs + 1)] == [1 + selection_due(number) for number in range(1, pairs + 1)]
    topics = [one.topic for one in outputs]
    seconds = [at for at, one in enumerate(outputs) if one.topic == "/drift/estimate"]
    for before, following in itertools.pairwise(seconds):
        if json.loads(outputs[before].payload)["pairs"] == json.loads(outputs[following].payload)["pairs"]:
            assert "/dic/summary" not in topics[before:following]
            assert SEM_IMAGE in topics[before:following]


def test_the_hold_is_observed_and_nothing_moves_while_a_pair_is_taken(finished: Any) -> None:
    states, pairs = logged(finished.log, "/state"), logged(finished.log, "/pair")
    commands = logged(finished.log, "/command")
    for pair in pairs:
        own = [state for state in states if state["step"] == pair["pair"]]
        settled = max(state["time_ns"] for state in own if state["cause"] == "settled")
        done = next(state["time_ns"] for state in own if state["cause"] == "pair_complete")
        assert pair["first"]["start_time_ns"]["value"] - settled >= 30e9
        assert not [c for c in commands if c["what"] in ("ramp_to", "move_stage") and settled < c["time_ns"] < done]


def test_every_exported_file_is_in_the_log_as_it_was(finished: Any) -> None:
    (segment,) = finished.log.glob("*.mcap")
    with segment.open("rb") as stream:
        originals = {message.sequence: message.data for _, _, message in make_reader(stream).iter_messages(topics=["/sem/original"])}
    arrived = [file for file in logged(finished.log, "/sem/file") if file["decision"] == "arrived"]
    assert len(arrived) == len(originals) >= PX * BOTH
    for file in arrived:
        assert originals[file["export"]] == (Path(finished.bench["export_folder"]) / file["name"]).read_bytes()


def test_the_report_is_one_page_that_needs_nothing_else(finished: Any, semlive: Command) -> None:
    page = finished.folder / "report.html"
    code, _, err = semlive("report", finished.log, "--out", page)
    assert code == 0, err
    text = page.read_text(encoding="utf-8")
    for title in (
        "Reference image with the measured points",
        "Protocol of the run",
        "Drift over scan time",
        "Distortion of the raster",
        "Strain under load",
        "Displacement at chosen load steps",
        "Strain at chosen load steps",
        "Stress over mean strain",
        "Elastic constants",
        "Comparison with the strain gage",
    ):
        assert f"{title}.</b>" in text
    assert "acceleration voltage 30 kV, detector BSED" in text
    images = re.findall(r'src="data:image/svg\+xml,([^"]*)"', text)
    assert len(images) == text.count("<img ") == 16
    for image in images:
        text = text.replace(image, "")
        # Names of XML definitions begin with http, too; what a browser would load is in a reference.
        references = re.findall(r'(?:href|src)="([^"]*)"|url\(([^)]*)\)', unquote(image))
        assert all(one.startswith(("#", "data:image/png;base64,")) for pair in references for one in pair if one)
    assert "http" not in text


def test_a_run_of_the_same_name_is_refused(finished: Any) -> None:
    code, printed = finished.run()
    assert code == 2
    assert "this run exists already; give run.name another name" in " ".join(printed.split())
