"""The page state is a pure function of the log; incremental updates for browsers add up to the complete state."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.experiment import Phase, Step
from semlive.data.grid import Grid
from semlive.data.loading import MotionState
from semlive.data.scan import Provenance, Sourced
from semlive.data.strain import MeasuredValue, Tensor2
from semlive.formats.log.maps import encode_map
from semlive.formats.log.messages import (
    DIC_MAP,
    DriftForecastMessage,
    DriftMessage,
    ElasticMessage,
    FaultMessage,
    FileMessage,
    LoadSampleMessage,
    LogLineMessage,
    OperatorMessage,
    Payload,
    RunMessage,
    ScanMessage,
    StateMessage,
    StrainMessage,
    to_json,
    topic_of,
)
from semlive.formats.log.reader import LogMessage
from semlive.web.downsampled_series import MAX_ROWS, DownsampledSeries, LoadRow, append
from semlive.web.fields import FieldStore, fields_of
from semlive.web.page_state import PageState
from semlive.web.reducer import reduce, with_maps
from semlive.web.serialise import full_state, state_diff, to_json_line

START_NS = 1_800_000_000_000_000_000
CONFIG: dict[str, Any] = {
    "sem": {"folder": ".", "pixel_size_um": 1.0},
    "load_frame": {"driver": "null"},
    "limits": dict(force_min_n=-50.0, force_max_n=900.0, extension_min_mm=-1.0, extension_max_mm=1.0, force_rate_max_n_s=50.0)
    | dict(force_step_max_n=900.0, stage_travel_um=100.0),
    "specimen": {"area_mm2": 10.0},
    "protocol": {
        "loads_n": [100.0, 200.0],
        "calibration_shifts_px": [[0, 0]],
        "hold_s": 30.0,
        "warm_up": {"max_rate_px_s": 0.01, "max_wait_s": 600.0},
    },
}


FILE: dict[str, Any] = {"size": 1, "sha256": "", "mtime_ns": 0, "arrival_time_ns": 0}


def at(seconds: float) -> int:
    return START_NS + round(1e9 * seconds)


def run() -> RunMessage:
    return RunMessage(run="r", started_time_ns=START_NS, host="lab", boot_id="b", versions={"semlive": "1"}, config=CONFIG)


def state(seconds: float, before: str, after_: str, cause: str, step: int = 0, **guards: float) -> StateMessage:
    return StateMessage(time_ns=at(seconds), before=before, after=after_, cause=cause, step=step, guards=dict(guards))


def load(seconds: float, force_n: float) -> LoadSampleMessage:
    return LoadSampleMessage(
        sequence=0, time_ns=at(seconds), mono_ns=0, force_n=force_n, extension_mm=0.1, motion=MotionState.STOPPED, target_n=force_n, raw=()
    )


def drift(revision: int, frames: tuple[int, ...]) -> DriftMessage:
    pairs = [(frame, 10.0 * frame + 5.0 * row) for frame in frames for row in (0, 1)]
    points = tuple((0.1 * revision, time_s) for _, time_s in pairs)
    forecast = DriftForecastMessage(time_s=(50.0, 60.0), duration_s=10.0, rate_px_s=((0.03, 0.04),) * 2, sigma_px_s=((0.0, 0.01),) * 2)
    numbers, times = tuple(frame for frame, _ in pairs), tuple(time_s for _, time_s in pairs)
    return DriftMessage(
        revision=revision, time_s=times, frame=numbers, drift_px=points, sigma_px=points, rate_px_s=points, forecast=forecast
    )


def message(payload: Payload, log_time_ns: int) -> LogMessage:
    return LogMessage(topic_of(payload), log_time_ns, log_time_ns, 0, to_json(payload))


MESSAGES: tuple[Payload, ...] = (
    run(),
    state(1, "idle", "connecting", "opening"),
    load(1, 0.0),
    state(2, "settling", "holding", "settled"),
    load(2, 1.0),
    FileMessage(export=1, name="a.tif", size=1, sha256="", mtime_ns=0, arrival_time_ns=0, decision="arrived", reason=""),
    FileMessage(export=1, name="", size=0, sha256="", mtime_ns=0, arrival_time_ns=0, decision="refused", reason="a.tif came too early"),
    drift(1, (0, 1)),
    drift(2, (1, 2)),
    state(3, "step_done", "warming", "warm_up", 1),
    state(4, "warming", "ramping", "measure_again", 1, rate_px_s=0.05, sigma_px_s=0.01, waited_s=120.0),
    StrainMessage(
        revision=1, frame=2, mean=Tensor2(1e-4, 2e-4, 0.0), mean_sigma=Tensor2(1e-6, 2e-6, 0.0), sd=Tensor2(0.0, 3e-4, 0.0), vsg_px=83.0
    ),
    ElasticMessage(revision=2, youngs_modulus_gpa=MeasuredValue(70.0, 1.0), poissons_ratio=MeasuredValue(0.3, 0.01)),
    OperatorMessage(time_ns=at(5), what="asked", args={"text": "bring the load", "question": "terminal.1", "wanted": "load_n"}),
    OperatorMessage(time_ns=at(5), what="told", args={"text": "that is no load"}),
    FaultMessage(time_ns=at(6), what="it is full", where="log", action="paused the run"),
    state(7, "ramping", "fault", "limit", 1),
    LogLineMessage(time_ns=at(7), level="info", text="the load is beyond its limit"),
    OperatorMessage(time_ns=at(8), what="taken_back", args={"text": "bring the load", "question": "terminal.1", "wanted": "load_n"}),
    run(),
)


def views() -> list[PageState]:
    reported = [PageState()]
    for number, payload in enumerate(MESSAGES):
        reported.append(reduce(reported[-1], message(payload, START_NS + number)))
    return reported


def test_increments_add_up_to_the_complete_state() -> None:
    shown: dict[str, Any] = json.loads(to_json_line(full_state(PageState())))
    rows: list[Any] = []
    lines: list[Any] = []
    everything = views()
    for before, now in pairwise(everything):
        parts = json.loads(to_json_line(state_diff(before, now)))
        news = parts.pop("load", None)
        if news is not None:
            rows[news["from"] :] = news["rows"]
        if more := parts.pop("lines", None):
            assert more["from"] == len(lines)
            lines += more["rows"]
        shown.update(parts)
        all_at_once = json.loads(to_json_line(full_state(now)))
        assert all_at_once.pop("lines") == {"from": 0, "rows": lines}
        assert all_at_once.pop("load") == {"from": 0, "rows": rows}
        shown.pop("load", None)
        shown.pop("lines", None)
        assert shown == all_at_once


def test_unchanged_parts_are_not_sent() -> None:
    now = views()[-1]
    assert state_diff(now, now) == {}
    assert set(state_diff(now, reduce(now, message(load(9, 5.0), START_NS + 99)))) == {"reading", "load"}


def test_a_fault_comes_with_what_to_do() -> None:
    reported = views()[-2]
    assert (reported.protocol.state, reported.protocol.message, reported.protocol.asks) == ("fault", "the load is beyond its limit", True)
    assert "Check specimen and load frame" in reported.protocol.advice
    full, limit = reported.alarms
    assert (full.text, full.code, full.advice) == (
        "log: it is full",
        "log",
        "Free space on the disk; when the log is written again, press Resume.",
    )
    assert (limit.text, limit.code, limit.time_s) == ("the load is beyond its limit", "limit", 7.0)
    assert reported.frames.refused[0].reason == "a.tif came too early"


def test_an_alarm_stays_until_it_is_acknowledged() -> None:
    view = reduce(
        views()[-1], message(FaultMessage(time_ns=at(9), what="it moves on", where="load frame", action="", code="stop_not_obeyed"), 99)
    )
    assert [item.disobeyed for item in view.alarms] == [False, False, True]
    assert "own emergency stop" in view.alarms[-1].advice
    assert {item.acknowledged_s for item in view.alarms} == {None}
    for number in range(300):
        view = reduce(view, message(LogLineMessage(time_ns=at(10 + number), level="warning", text="slow"), 100 + number))
        view = reduce(
            view, message(FaultMessage(time_ns=at(10 + number), what="no points", where="pair 3", action="left out"), 100 + number)
        )
    assert len(view.alarms) <= 301
    assert view.alarms[0].disobeyed
    args = {"alarm": view.alarms[0].identity, "by": "terminal"}
    view = reduce(view, message(OperatorMessage(time_ns=at(400), what="acknowledge", args=args), 999))
    assert not any(item.disobeyed for item in view.alarms)
    newest = view.alarms[-1]
    args = {"alarm": newest.identity, "by": "terminal"}
    view = reduce(view, message(OperatorMessage(time_ns=at(401), what="acknowledge", args=args), 1000))
    assert (view.alarms[-1].acknowledged_s, view.alarms[-1].acknowledged_by) == (401.0, "terminal")


def test_names_from_outside_are_shown_without_control_characters() -> None:
    name = "a\x1b[2J\n\u202eb.tif"
    view = reduce(views()[-1], message(FileMessage(**FILE, export=2, name=name, decision="arrived", reason=""), 99))
    view = reduce(view, message(FileMessage(**FILE, export=2, name=name, decision="refused", reason=f"{name} is truncated"), 99))
    view = reduce(view, message(LogLineMessage(time_ns=at(9), level="warning", text=f"seen: {name}"), 99))
    shown = "a\\x1b[2J\\n\\u202eb.tif"
    assert (view.frames.name, view.frames.refused[0].name, view.frames.refused[0].reason) == (shown, shown, f"{shown} is truncated")
    assert view.alarms[-1].text == f"seen: {shown}"


def test_the_end_of_a_hold_is_shown_only_while_it_lasts() -> None:
    ends = {reported.protocol.state: reported.protocol.hold_end_s for reported in views()}
    assert ends["holding"] == 32.0
    assert {end for where, end in ends.items() if where != "holding"} == {None}


def test_a_question_stays_until_it_is_answered_or_taken_back() -> None:
    reported = views()
    requests = next(item for item in reported if item.desk.told)
    assert [(item.question, item.wanted) for item in requests.desk.questions] == [("terminal.1", "load_n")]
    assert not reported[-1].desk.questions
    ended = reduce(requests, message(state(9, "fault", "aborted", "abort"), START_NS + 99))
    assert not ended.desk.questions


def test_the_gate_s_verdict_and_the_pair_that_it_adds() -> None:
    reported = next(item for item in views() if item.schedule.measures)
    assert reported.drift.verdict == "warming up: forecast 3 ± 0.6 px/min, 0.6 px/min required, waited 2 min"
    steps = full_state(reported)["schedule"]["steps"]
    assert [(item["warm_up"], item["load_n"]) for item in steps] == [(True, None), (False, None), (False, 100.0), (False, 200.0)]
    done = Step(0, Phase.CALIBRATION, (0.0, 0.0), (0.0, 0.0), None, warm_up=True)
    assert reported.schedule.planned[0].warm_up is False
    assert done.warm_up


def test_drift_is_that_of_the_newest_revision_and_its_forecast_continues_from_there() -> None:
    drift_panel = views()[-1].drift
    assert [item.frame for item in drift_panel.frames] == [0, 1, 2]
    assert [item.rows[0][1] for item in drift_panel.frames] == [pytest.approx(0.1), pytest.approx(0.2), pytest.approx(0.2)]
    assert drift_panel.rate_px_s == (pytest.approx(0.05), pytest.approx(0.01))
    last = drift_panel.frames[-1].rows[-1]
    assert drift_panel.forecast[0] == last
    assert drift_panel.forecast[-1][:3] == (70.0, pytest.approx(last[1] + 0.03 * 45.0), pytest.approx(last[2] + 0.04 * 45.0))


def test_a_week_of_readings_is_no_longer_than_a_page_can_draw() -> None:
    trace, peak_s = DownsampledSeries(), 3000.0
    for number in range(60_000):
        time_s = 0.1 * number
        force_n = 500.0 if time_s == peak_s else 0.0
        trace = append(trace, LoadRow(time_s, force_n, force_n, 0.0, 0.0))
    assert len(trace.rows) <= MAX_ROWS
    assert max(row.high_n for row in trace.rows) == 500.0
    times = [row.time_s for row in trace.rows]
    assert times == sorted(times)
    assert times[-1] == pytest.approx(6000.0, abs=2 * trace.width_s)


def test_maps_are_what_was_correlated_and_points_that_do_not_count_are_no_numbers() -> None:
    grid = Grid(10, 20, 5, 4, 3, 21)
    field = np.arange(12, dtype=np.float64).reshape(3, 4)
    status = np.zeros((3, 4), dtype=np.uint8)
    status[1, 2] = PoiStatus.LOW_ZNCC
    disparity = DisparityMap(0, 3, grid, field, -field, 0.01 + 0 * field, 0.01 + 0 * field, 0.9 + 0 * field, status)
    fields = fields_of(LogMessage(DIC_MAP, 1, 1, 3, encode_map(disparity)))
    assert fields is not None
    store = FieldStore()
    store.store(fields)
    store.store(fields)
    read = store.read(3, "disparity_u")
    assert read is not None
    values = np.frombuffer(read, "<f4").reshape(3, 4)
    assert np.isnan(values[1, 2])
    assert np.array_equal(np.delete(values.ravel(), 6), np.delete(field.ravel(), 6))
    assert store.read(4, "disparity_u") is None
    assert store.read(3, "../../passwords") is None
    view = with_maps(views()[-1], fields)
    assert view.maps.grid == (10, 20, 5, 4, 3, 21)
    names = ("disparity_u", "disparity_v", "disparity_sigma_u", "disparity_sigma_v", "zncc")
    assert [(item.frame, item.fields) for item in view.maps.frames] == [(3, names)]
    assert (view.quality[-1].converged, view.quality[-1].zncc) == (11, pytest.approx(0.9))


def test_the_log_s_newest_lines_are_shown_with_transitions_and_only_new_ones_are_sent() -> None:
    view = views()[-1]
    assert [(row.level, row.text) for row in view.lines.rows[:2]] == [
        ("state", "idle → connecting (opening)"),
        ("state", "settling → holding (settled)"),
    ]
    before = view
    for number in range(200):
        view = reduce(view, message(LogLineMessage(time_ns=at(20 + number), level="info", text=f"line {number}"), START_NS + number))
    assert len(view.lines.rows) == 60
    sent = state_diff(before, view)["lines"]
    assert (sent["from"], len(sent["rows"]), sent["rows"][-1]["text"]) == (before.lines.count + 140, 60, "line 199")


def test_pixel_size_and_scan_time_are_those_of_the_newest_file() -> None:
    values = {"dwell_time_s": 1e-5, "row_time_s": 0.01, "frame_time_s": 9.0, "integrations": 1, "start_time_ns": 0, "pixel_size_m": 2.5e-7}
    sourced: dict[str, Any] = {name: Sourced(value, Provenance.FILE) for name, value in values.items()}
    size = {"frame": 0, "export": 0, "width_px": 800, "height_px": 600, "databar_rows": 20}
    scan = ScanMessage(**size, **sourced, name="a.tif", vendor="plain", start_sigma_s=0.0, end_time_ns=0)
    view = reduce(views()[-1], message(scan, START_NS))
    assert (view.scan.pixel_um, view.scan.scan_s, view.scan.size_px) == (pytest.approx(0.25), 9.0, (800, 600))
    assert view.progress.scan_s == 9.0
    assert full_state(view)["progress"]["remaining_s"] > 0.0
