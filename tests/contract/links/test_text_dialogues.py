"""The test stand of the bench over text: readings, orders, changed settings and late replies."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from semlive.data.checks import Verdict
from semlive.data.loading import ControlMode, MotionState, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError
from semlive.ports import BlindStop, LoadFrame, OrderCheck
from semlive_drivers.check import check_frame
from semlive_drivers.composite_load_frame import CompositeLoadFrame
from semlive_drivers.text.load_frame import open_load_frame
from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.load_frame.ascii_stand import AsciiTestStand
from semlive_simulators.load_frame.line_faults import Line, LineFault, LineFaultInjector
from semlive_simulators.load_frame.serial_lines import ascii_line
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.machine import LoadTrain

from ...clocks import MonotonicClock
from ...waiting import wait_until

CLOCK = MonotonicClock()
APPROACH = {"stiffness_n_mm": 8000.0, "speed_max_mm_s": 0.05, "speed_min_mm_s": 0.0084, "arrived_n": 12.0, "ahead_s": 0.6}


class Stand:
    """The bench's test stand on its line."""

    def __init__(self, path: str, machine: LoadTrain, troubles: LineFaultInjector, clock: BenchClock, letters: AsciiTestStand) -> None:
        self.path, self.machine, self.troubles, self.clock, self.letters = path, machine, troubles, clock, letters

    def settings(self, **more: object) -> dict[str, object]:
        line = {"port": self.path, "slowest_s": 0.2}
        return {"map": "mark10_esm", "serial": line, "confirmed": True, "approach": APPROACH, "timeout_s": 2.0, **more}


@pytest.fixture
def stand() -> Iterator[Stand]:
    clock = BenchClock(1.0, lambda _: None)
    machine = LoadTrain(load_scenario("paper_x200"), clock.start_ns)
    machine.read(clock.start_ns)
    troubles = LineFaultInjector((), lambda: 0.0)
    clock.begin()
    over = threading.Event()
    with ascii_line(machine, clock.now_ns, troubles) as (path, letters):

        def watch() -> None:
            while not over.wait(0.02):
                letters.watch_limits()

        watching = threading.Thread(target=watch)
        watching.start()
        yield Stand(path, machine, troubles, clock, letters)
        over.set()
        watching.join()


@pytest.fixture
def frame(stand: Stand) -> Iterator[LoadFrame]:
    opened = open_load_frame(stand.settings(), CLOCK)
    yield opened
    opened.close()


def test_a_stand_reports_load_extension_and_motion(stand: Stand, frame: LoadFrame) -> None:
    assert isinstance(frame, LoadFrame)
    assert frame.identity.name == f"load frame at {stand.path}"
    assert frame.identity.stop_on_link_loss is StopOnLinkLoss.NONE
    sample = frame.read()
    assert sample.force_n == pytest.approx(0.0, abs=15.0)
    assert (sample.motion, sample.extension_mm) == (MotionState.STOPPED, pytest.approx(0.0, abs=2e-3))


def test_a_stand_is_brought_to_a_load_and_stopped_there(stand: Stand, frame: LoadFrame) -> None:
    frame.ramp_to(150.0, 100.0)
    assert frame.read().motion is MotionState.MOVING
    wait_until(lambda: frame.read().motion is MotionState.STOPPED)
    assert frame.read().force_n == pytest.approx(150.0, abs=40.0)
    assert stand.machine.jogging_mm_s == 0.0


def test_a_stand_that_is_left_alone_stops_at_the_limit_that_was_set(stand: Stand, frame: LoadFrame) -> None:
    frame.ramp_to(1500.0, 400.0)
    wait_until(lambda: stand.machine.read(stand.clock.now_ns()).extension_mm > 0.005)
    wait_until(lambda: stand.machine.jogging_mm_s == 0)
    assert stand.machine.read(stand.clock.now_ns()).extension_mm < 0.05 * APPROACH["ahead_s"] + 0.02


def test_a_stop_is_confirmed_by_the_stand(stand: Stand, frame: LoadFrame) -> None:
    frame.ramp_to(500.0, 200.0)
    wait_until(lambda: stand.machine.jogging_mm_s > 0)
    frame.stop()
    assert stand.machine.jogging_mm_s == 0.0
    assert frame.read().motion is MotionState.STOPPED


@pytest.mark.parametrize(
    ("letters", "sentence"),
    [(b"e0123.0", "its speed is 2.05 mm/s, "), (b"h005.00", "its upper is 5 mm, ")],
)
def test_a_setting_that_somebody_changes_in_a_ramp_is_noticed_and_ends_it(
    stand: Stand, frame: CompositeLoadFrame, letters: bytes, sentence: str
) -> None:
    frame.ramp_to(1500.0, 100.0)
    assert [frame.read().order_changed for _ in range(4)] == [None] * 4
    stand.letters.answer(letters)
    found = str(frame.read().order_changed)
    assert sentence in found
    assert "another program or a person commands it" in found
    before_mm = stand.letters.answer(b"v")
    frame.read()
    assert stand.letters.answer(b"v") == before_mm  # no further travel is ordered
    frame.stop()
    frame.ramp_to(1500.0, 100.0)
    assert [frame.read().order_changed for _ in range(4)] == [None] * 4
    frame.stop()


def test_settings_that_nobody_changes_are_no_other_order(stand: Stand, frame: CompositeLoadFrame) -> None:
    observed = [frame.read()]

    def rests() -> bool:
        observed.append(frame.read())
        return observed[-1].motion is MotionState.STOPPED

    for target_n in (150.0, 40.0):
        frame.ramp_to(target_n, 100.0)
        wait_until(rests)
        frame.stop()
        observed += [frame.read() for _ in range(3)]
    assert {item.order_changed for item in observed} == {None}


def test_a_late_answer_is_refused_and_the_next_ones_are_right(stand: Stand) -> None:
    frame = open_load_frame(stand.settings(timeout_s=0.3), CLOCK)
    stand.troubles.order(LineFault.LATE, [Line.SERIAL], 1, 0.6)
    with pytest.raises(LinkError, match=r"gave no complete answer within 0\.3 s to 'p'"):
        frame.read()
    with pytest.raises(LinkError, match="an earlier answer is still pending"):
        frame.read()
    frame.close()
    again = open_load_frame(stand.settings(serial={"port": stand.path, "slowest_s": 0.8}), CLOCK)
    assert [again.read().motion for _ in range(5)] == [MotionState.STOPPED] * 5
    again.close()


@pytest.mark.parametrize("closed", [False, True])
def test_a_stop_is_sent_although_answers_do_not_come_or_the_line_is_closed(stand: Stand, closed: bool) -> None:
    frame = open_load_frame(stand.settings(timeout_s=0.3), CLOCK)
    assert isinstance(frame, BlindStop)
    frame.ramp_to(150.0, 100.0)
    stand.troubles.order(LineFault.LOST, [Line.SERIAL], 1, 0.0)
    with pytest.raises(LinkError):
        wait_until(lambda: frame.read().force_n > 1e6)
    if closed:
        frame.close()
        stand.machine.travel_to(1.0, 0.01)
    for _ in range(2):
        assert frame.stop_blind()
    wait_until(lambda: not stand.machine.read(stand.clock.now_ns()).load_frame_moving)
    frame.close()
    open_load_frame(stand.settings(timeout_s=0.3), CLOCK).close()


def test_a_stand_reports_how_fine_its_readings_are_and_which_orders_it_cannot_hold(frame: LoadFrame) -> None:
    assert isinstance(frame, OrderCheck)
    assert frame.identity.control is ControlMode.DISPLACEMENT
    assert frame.identity.force_resolution_n == pytest.approx(0.01)
    assert frame.identity.extension_resolution_mm == pytest.approx(0.001)
    assert frame.order_problem(150.0, 100.0) is None
    assert "slower than speed_min_mm_s 0.0084; order at least 67.2 N/s" in str(frame.order_problem(150.0, 10.0))
    assert "but the drive takes" in str(frame.order_problem(150.0, 79.0))


def read_three_times(frame: LoadFrame) -> None:
    """What comes twice is discarded with the next request at the latest."""
    for _ in range(3):
        frame.read()


@pytest.mark.parametrize("trouble", [LineFault.NOISE, LineFault.WRONG_CHECK, LineFault.TWICE, LineFault.LOST])
def test_what_is_spoiled_is_no_reading(stand: Stand, frame: LoadFrame, trouble: LineFault) -> None:
    stand.troubles.order(trouble, [Line.SERIAL], 1, 0.01)
    with pytest.raises(LinkError, match=r"sent|gave no complete answer"):
        read_three_times(frame)


def test_a_reply_in_pieces_is_a_reply(stand: Stand, frame: LoadFrame) -> None:
    stand.troubles.order(LineFault.SPLIT, [Line.SERIAL], 2, 0.05)
    assert frame.read().motion is MotionState.STOPPED


def test_a_force_in_another_unit_is_the_same_force(stand: Stand, frame: LoadFrame) -> None:
    stand.machine.jog(0.1)
    wait_until(lambda: frame.read().force_n > 300.0)
    frame.stop()
    before_n = frame.read().force_n
    stand.troubles.order(LineFault.WRONG_UNIT, [Line.SERIAL], 2, 0.0)
    assert frame.read().force_n == pytest.approx(before_n, abs=40.0)


def test_a_look_at_the_stand_gives_no_order(stand: Stand) -> None:
    found = check_frame("mark10_esm", {"unit": 1, "timeout_s": 0.5, "serial": {"port": stand.path, "slowest_s": 0.2}}, CLOCK)
    printed = {finding.what: finding for finding in found.findings}
    assert printed["force"].verdict is Verdict.OK
    assert printed["motion"].observation == "S"
    assert found.passed
    with pytest.raises(BadConfig, match="mark10_esm is connected by a serial line; give its path"):
        check_frame("mark10_esm", {"host": "127.0.0.1", "port": 502}, CLOCK)


def test_an_unconfirmed_stand_is_not_moved(stand: Stand) -> None:
    frame = open_load_frame(stand.settings(confirmed=False), CLOCK)
    with pytest.raises(LinkError, match="from public documents, confirm before motion"):
        frame.ramp_to(500.0, 1.0)
    assert stand.machine.jogging_mm_s == 0.0
    frame.close()
