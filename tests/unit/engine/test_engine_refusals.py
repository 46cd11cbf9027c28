"""Each reason for which a frame is not part of a pair."""

from __future__ import annotations

from dataclasses import replace

import pytest

from semlive.data.frame import ColumnSettings
from semlive.data.scan import Provenance, ScanGeometry, Sourced
from semlive.engine import FrameScanned, FrameUnreadable, LinkStale, OperatorAction, OperatorCommand, State
from semlive.engine.events import Device
from semlive.engine.frame_selection import difference

from .bench_in_memory import Run, S, frame, plan_of

HERE = (0.0, 0.0)


@pytest.fixture
def imaging() -> Run:
    """A loaded run that images its first step."""
    run = Run(plan_of((HERE, 200.0), (HERE, 400.0)))
    run.begin()
    run.reach(State.IMAGING)
    return run


def only_reason(run: Run) -> str:
    assert len(run.refusals) == 1, run.refusals
    return run.refusals[0]


def test_a_frame_that_began_before_the_hold_ended() -> None:
    run = Run(plan_of((HERE, 200.0)))
    run.begin()
    run.reach(State.HOLDING)
    run.wait(20.0)
    run.scan()
    assert only_reason(run) == (
        "frame0000.tif is not used: its scan may have begun 10.9 s before the hold of step 1 ended (its start is known within 0.9 s)"
    )
    assert run.state.state is State.IMAGING


def test_a_frame_that_only_may_have_started_too_early_counts_as_too_early(imaging: Run) -> None:
    end_ns = imaging.state.hold.end_ns
    imaging.scan(end_ns + round(0.89 * S))
    assert "may have begun 0.0 s before" in only_reason(imaging)
    imaging.scan(imaging.now_ns)
    assert len(imaging.refusals) == 1


def test_a_frame_that_arrives_while_holding() -> None:
    run = Run(plan_of((HERE, 200.0)))
    run.begin()
    run.reach(State.HOLDING)
    run.send(FrameScanned(run.now_ns, frame(0, run.now_ns - 92 * S)))
    assert "before the hold of step 1 ended" in only_reason(run)


@pytest.mark.parametrize(
    ("state", "why"),
    [(State.RAMPING, "load or stage were being set"), (State.SETTLING, "load and stage were settling")],
)
def test_a_frame_that_arrives_before_the_hold(state: State, why: str) -> None:
    run = Run(plan_of((HERE, 200.0)))
    run.begin()
    run.reach(state)
    run.send(FrameScanned(run.now_ns, frame(0, run.now_ns - 92 * S)))
    assert only_reason(run) == f"frame0000.tif is not used: {why} when it arrived"


def test_a_frame_outside_of_all_steps() -> None:
    run = Run(plan_of((HERE, 200.0)))
    run.send(FrameScanned(run.now_ns, frame(0, run.now_ns - 92 * S)))
    assert "no step was being imaged (the run is idle)" in only_reason(run)


def test_a_frame_from_a_sem_whose_clock_is_ahead(imaging: Run) -> None:
    imaging.send(FrameScanned(imaging.now_ns, frame(0, imaging.now_ns + 3600 * S)))
    imaging.wait(1.0)
    assert "its scan ended 3689.1 s after it arrived; set the SEM's clock" in only_reason(imaging)


def test_the_same_frame_twice(imaging: Run) -> None:
    info = imaging.scan()
    imaging.send(FrameScanned(imaging.now_ns, replace(info, export=1, name="copy.tif")))
    imaging.wait(1.0)
    assert "copy.tif is not used: it does not follow frame0000.tif" in only_reason(imaging)


def test_when_the_settings_change_inside_a_pair_the_second_becomes_the_first(imaging: Run) -> None:
    imaging.scan(width_px=512)
    imaging.scan()
    assert only_reason(imaging) == "frame0000.tif is not used: the frame after it has 1024 x 884 px instead of 512 x 884"
    imaging.scan()
    assert [i.export for i in (imaging.accepted[0].decision.first, imaging.accepted[0].decision.second)] == [1, 2]


def test_a_frame_unlike_the_first_pair_is_refused(imaging: Run) -> None:
    imaging.scan()
    imaging.scan()
    imaging.reach(State.IMAGING)
    imaging.scan(dwell_s=2e-4)
    assert only_reason(imaging) == "frame0002.tif is not used: it has dwell time 0.0002 s instead of 0.0001 s as in the first pair"


def test_kinds_differ_by_each_of_their_settings() -> None:
    a = frame(0, 0)
    twice = replace(a.timing, integrations=Sourced(2, Provenance.FILE))
    slower = replace(a.timing, row_time_s=Sourced(0.2, Provenance.FILE))
    assert difference(a, a) is None
    assert difference(a, frame(0, 0, dwell_s=1.0005e-4)) is None
    assert "integrated scans" in (difference(a, replace(a, timing=twice)) or "")
    assert "row time" in (difference(a, replace(a, timing=slower)) or "")
    assert "pixel size" in (difference(a, replace(a, pixel_size_m=Sourced(1e-6, Provenance.FILE))) or "")


def test_settings_of_the_column_differ_by_name() -> None:
    source = Provenance.FILE
    column = ColumnSettings(
        Sourced("ETD", source), Sourced(5e3, source), Sourced(0.01, source), Sourced(200.0, source), Sourced(0.0, source)
    )
    a = replace(frame(0, 0), column=column)
    for change, words in (
        (replace(column, detector=Sourced("BSD", source)), "detector BSD instead of ETD"),
        (replace(column, voltage_v=Sourced(1e4, source)), "voltage 10000 V instead of 5000 V"),
        (replace(column, magnification=Sourced(250.0, source)), "magnification 250 x instead of 200 x"),
        (replace(column, scan_rotation_deg=Sourced(90.0, source)), "scan rotation 90 degrees instead of 0 degrees"),
    ):
        assert difference(a, replace(a, column=change)) == words
    refocused = replace(a, column=replace(column, working_distance_m=Sourced(0.011, source)))
    assert difference(a, refocused) is None  # from step to step the focus may follow the specimen
    passes = replace(a.timing, line_integrations=Sourced(2, source))
    assert difference(a, replace(a, timing=passes)) == "2 passes over each line instead of 1"
    longer = replace(a.timing, frame_time_s=Sourced(95.0, source))
    assert difference(a, replace(a, timing=longer)) == "frame time 95 s instead of 90 s"


def test_focus_that_is_changed_inside_a_pair_costs_its_first_frame(imaging: Run) -> None:
    imaging.wait(2.0)
    for number, distance_m in enumerate((0.01, 0.011)):
        info = frame(number, imaging.now_ns)
        imaging.wait(92.0)
        column = ColumnSettings(working_distance_m=Sourced(distance_m, Provenance.FILE))
        imaging.send(FrameScanned(imaging.now_ns, replace(info, column=column)))
        imaging.wait(1.0)
    assert only_reason(imaging) == "frame0000.tif is not used: the frame after it has working distance 0.011 m instead of 0.01 m"


def test_tilt_correction_that_is_switched_on_inside_a_pair_costs_its_first_frame(imaging: Run) -> None:
    imaging.wait(2.0)
    for number, is_on in enumerate((False, True)):
        info = frame(number, imaging.now_ns)
        imaging.wait(92.0)
        geometry = ScanGeometry(tilt_correction=Sourced(is_on, Provenance.FILE))
        imaging.send(FrameScanned(imaging.now_ns, replace(info, geometry=geometry)))
        imaging.wait(1.0)
    assert only_reason(imaging) == "frame0000.tif is not used: the frame after it has tilt correction on instead of off"
    assert imaging.accepted == []


def test_a_load_out_of_tolerance_costs_the_pair_its_first_frame(imaging: Run) -> None:
    imaging.scan()
    imaging.force_n = 189.0
    imaging.wait(1.0)
    assert only_reason(imaging) == "frame0000.tif is not used: the load is -11.0 N from its target while step 1 was imaged"
    assert imaging.state.state is State.SETTLING
    assert imaging.accepted == []


def test_a_frame_waits_until_the_load_at_the_end_of_its_scan_is_measured(imaging: Run) -> None:
    imaging.scan()
    info = frame(9, imaging.now_ns)
    imaging.wait(90.0)
    imaging.send(FrameScanned(imaging.now_ns + S, info))
    assert imaging.accepted == []
    imaging.force_n = 150.0
    imaging.now_ns += S
    imaging.readings()
    assert imaging.accepted == []
    assert len(imaging.refusals) == 2


def test_no_frame_is_judged_on_stale_samples(imaging: Run) -> None:
    imaging.scan()
    info = frame(9, imaging.now_ns)
    imaging.wait(92.0)
    imaging.send(LinkStale(imaging.now_ns, Device.LOAD_FRAME))
    imaging.send(FrameScanned(imaging.now_ns, info))
    assert imaging.accepted == imaging.refusals == []
    imaging.wait(1.0)
    assert len(imaging.accepted) == 1


def test_the_hold_does_not_end_on_stale_samples() -> None:
    run = Run(plan_of((HERE, 200.0)), has_stage=False)
    run.begin()
    run.reach(State.HOLDING)
    run.send(LinkStale(run.now_ns, Device.LOAD_FRAME))
    run.has_load = False
    run.wait(60.0)
    assert run.state.state is State.HOLDING
    run.has_load = True
    run.wait(0.5)
    assert run.state.state is State.IMAGING


def test_pausing_costs_the_pair_its_first_frame(imaging: Run) -> None:
    imaging.scan()
    imaging.send(OperatorAction(imaging.now_ns, OperatorCommand.PAUSE))
    assert only_reason(imaging) == "frame0000.tif is not used: paused by the operator while imaging"
    imaging.send(FrameScanned(imaging.now_ns, frame(8, imaging.now_ns - 92 * S)))
    assert "the run was paused" in imaging.refusals[1]


def test_an_unreadable_file_is_refused_with_its_own_message(imaging: Run) -> None:
    imaging.scan()
    imaging.send(FrameUnreadable(imaging.now_ns, 1, "frame0001.tif is cut off after 3 of 884 rows; export it again"))
    imaging.scan()
    assert only_reason(imaging) == "frame0001.tif is cut off after 3 of 884 rows; export it again"
    assert len(imaging.accepted) == 1


def test_a_pair_without_a_stored_load_is_refused_instead_of_inventing_a_load(imaging: Run) -> None:
    imaging.scan()
    devices = imaging.state.devices
    devices = replace(devices, history=replace(devices.history, chunks=(), tail=()))
    imaging.state = replace(imaging.state, devices=devices)
    imaging.scan()
    assert imaging.accepted == []
    assert only_reason(imaging) == "frame0000.tif is not used: the load during its scan is not known any more"
