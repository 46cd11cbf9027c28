"""Devices that speak text: the test stand of the bench, an amplifier as its public drivers describe it, and one with checksums."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.data.checks import Verdict
from semlive.data.loading import ControlMode, MotionState, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.ports import BlindStop, LoadFrame, OrderCheck, StopMethods
from semlive_drivers.check import check_frame
from semlive_drivers.composite_load_frame import CompositeLoadFrame
from semlive_drivers.text.codec import CheckKind, Checksum, fill_template, with_check, without_check
from semlive_drivers.text.load_frame import open_load_frame
from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.load_frame.ascii_stand import AsciiTestStand
from semlive_simulators.load_frame.line_faults import Line, LineFault, LineFaultInjector
from semlive_simulators.load_frame.serial_lines import ascii_line
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.machine import LoadTrain

from .processes import WallClock, wait_until
from .text_server import over_text

CLOCK = WallClock()
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


def test_a_stand_tells_load_extension_and_motion(stand: Stand, frame: LoadFrame) -> None:
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
    seen = [frame.read()]

    def rests() -> bool:
        seen.append(frame.read())
        return seen[-1].motion is MotionState.STOPPED

    for target_n in (150.0, 40.0):
        frame.ramp_to(target_n, 100.0)
        wait_until(rests)
        frame.stop()
        seen += [frame.read() for _ in range(3)]
    assert {one.order_changed for one in seen} == {None}


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


def test_a_stand_tells_how_fine_its_readings_are_and_which_orders_it_cannot_hold(frame: LoadFrame) -> None:
    assert isinstance(frame, OrderCheck)
    assert frame.identity.control is ControlMode.DISPLACEMENT
    assert frame.identity.force_resolution_n == pytest.approx(0.01)
    assert frame.identity.extension_resolution_mm == pytest.approx(0.001)
    assert frame.order_problem(150.0, 100.0) is None
    assert "slower than speed_min_mm_s 0.0084; order at least 67.2 N/s" in str(frame.order_problem(150.0, 10.0))
    assert "but the drive takes" in str(frame.order_problem(150.0, 79.0))


def read_three_times(frame: LoadFrame) -> None:
    """What comes twice is heard with the next request at the latest."""
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
    said = {finding.what: finding for finding in found.findings}
    assert said["force"].verdict is Verdict.OK
    assert said["motion"].observation == "S"
    assert found.passed
    with pytest.raises(BadConfig, match="mark10_esm is connected by a serial line; give its path"):
        check_frame("mark10_esm", {"host": "127.0.0.1", "port": 502}, CLOCK)


def test_an_unconfirmed_stand_is_not_moved(stand: Stand) -> None:
    frame = open_load_frame(stand.settings(confirmed=False), CLOCK)
    with pytest.raises(LinkError, match="from public documents, confirm before motion"):
        frame.ramp_to(500.0, 1.0)
    assert stand.machine.jogging_mm_s == 0.0
    frame.close()


class Amplifier:
    """A load cell's amplifier at station 7."""

    def __init__(self) -> None:
        self.load, self.stat, self.asked = 1.234567, 0, []

    def __call__(self, line: str) -> str:
        self.asked.append(line)
        told = {"STN?": 7.0, "SYS?": self.load, "STAT?": float(self.stat)}
        station, _, what = line.partition(":")
        return "" if station != "!007" else f"{told[what]:+.6f}\r" if what in told else "?\r"


def test_an_amplifier_tells_its_load_in_the_unit_of_the_configuration() -> None:
    amplifier = Amplifier()
    with over_text(amplifier) as path:
        line = {"port": path, "slowest_s": 0.05}
        frame = open_load_frame({"map": "mantracourt_dsc", "serial": line, "station": 7, "units": {"force": "kN"}}, CLOCK)
        assert frame.identity.name == f"load frame at {path} station 7"
        assert frame.read().force_n == pytest.approx(1234.567)
        amplifier.stat = 1 << 9
        with pytest.raises(LinkError, match=r"gives no reading: the load is beyond the range \(SYSOR\)"):
            frame.read()
        amplifier.stat = 1 << 13
        assert frame.read().force_n == pytest.approx(1234.567)
        with pytest.raises(LinkError, match="cannot be moved by semlive"):
            frame.ramp_to(1.0, 1.0)
        frame.close()
        with pytest.raises(LinkRefused, match="is another device than Mantracourt DSC"):
            open_load_frame({"map": "mantracourt_dsc", "serial": line, "station": 3, "timeout_s": 0.05}, CLOCK)
    assert not [asked for asked in amplifier.asked if "?" not in asked]


CHECKED = """
protocol: ascii
name: with checksums
source: a test
checksum: {kind: xor, lead: "*"}
ends: "\\r\\n"
refused: "NAK"
asks: {load: {send: "RD\\r", reply: 'F=(?P<force>[-+.\\d]+) (?P<force_unit>\\w+)'}}
every_turn: [load]
"""


def test_units_in_the_reply_and_checksums_on_every_line(tmp_path: Path) -> None:
    path = tmp_path / "checked.yaml"
    path.write_text(CHECKED, encoding="utf-8")
    replies = ["F=+2.5 kN*34", "F=+2.5 lbF*2B", "F=+2.5 kN*00", "F=+2.5 stone*12", "NAK*44"]
    asked = []

    def answer(line: str) -> str:
        asked.append(line)
        text = replies[min(len(asked), len(replies)) - 1]
        body, _, said = text.partition("*")
        return (text if said == "00" else with_check(body.encode(), Checksum(CheckKind.XOR, "*")).decode()) + "\r\n"

    with over_text(answer) as line:
        frame = open_load_frame({"map": str(path), "serial": {"port": line, "slowest_s": 0.05}}, CLOCK)
        assert frame.read().force_n == pytest.approx(2.5 * 4.4482216, rel=1e-6)
        with pytest.raises(LinkError, match="reply with a wrong checksum"):
            frame.read()
        with pytest.raises(BadConfig, match="unit 'stone' is not known"):
            frame.read()
        with pytest.raises(LinkError, match="does not understand 'RD'"):
            frame.read()
        frame.close()
    assert set(asked) == {"RD*16"}


@given(st.floats(-900, 900), st.integers(0, 3))
def test_a_number_in_a_request_reads_back(value: float, decimals: int) -> None:
    text = fill_template(f"x{{to_mm:+3.{decimals}}}y", {"to_mm": value}).decode()
    assert text[1] in "+-"
    assert float(text[1:-1]) == pytest.approx(value, abs=0.501 * 10**-decimals)
    outward = float(fill_template(f"{{to_mm:3.{decimals}!}}", {"to_mm": value}))
    assert abs(outward) >= abs(value) - 1e-5


@given(st.binary(max_size=40), st.sampled_from(CheckKind))
def test_a_checksum_finds_a_changed_byte(text: bytes, kind: CheckKind) -> None:
    check = Checksum(kind)
    sent = with_check(text, check)
    assert without_check(sent, check, "it") == text
    if text:
        with pytest.raises(LinkError, match="wrong checksum"):
            without_check(bytes([sent[0] ^ 1]) + sent[1:], check, "it")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("every_turn: [lood]", "'lood' is not among asks"),
        ("orders: {stop: [{send: s, ask: load}]}", "a step either sends or asks"),
        ("orders: {pull: [{send: 'e{speed:3}'}]}", "contains speed; there are force_n"),
        ("asks: {load: {send: n, reply: '(?P<force'}}", "is no regular expression"),
        ("other_stops: [{says: power off, steps: [{send: 'o{speed:3}'}]}]", "contains speed; there are force_n"),
        ("read_back: {pull: [{ask: load}]}", "a step of read_back asks and compares with equals"),
        ("ranges: {stat: [0, 1]}", "ranges needs 'stat', which no question of every_turn asks"),
        ("ranges: {force: [1, 0]}", "ranges.force must give the low end first"),
        ("valid: [{group: stat, bit: 3, says: bad}]", "valid needs 'stat', which no question of every_turn asks"),
    ],
)
def test_what_is_wrong_in_a_dialogue_is_said(tmp_path: Path, change: str, sentence: str) -> None:
    key = change.split(":")[0]
    lines = [line for line in CHECKED.splitlines() if not line.startswith(key)] + [change]
    path = tmp_path / "mine.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(BadConfig, match=sentence):
        open_load_frame({"map": str(path), "serial": {"port": "none"}}, CLOCK)


TAKES_LOADS = """
protocol: ascii
name: takes loads
source: a test
confirmed: true
asks:
  load: {send: "f\\r", reply: '(?P<force>[-+]?[0-9.]+) (?P<motion>[MS])'}
  aim: {send: "t\\r", reply: '(?P<aim>[-+]?[0-9.]+)'}
  rate: {send: "v\\r", reply: '(?P<rate>[0-9.]+)'}
every_turn: [load]
motion: {M: moving, S: stopped}
orders:
  ramp: [{send: "r{rate_n_s:1.2}\\r"}, {send: "g{force_n:1.1}\\r"}, {ask: aim, equals: {aim: force_n}, tolerance: 0.5}]
  stop: [{send: "s\\r"}]
read_back:
  ramp: [{ask: rate, equals: {rate: rate_n_s}, tolerance: 0.01}]
"""


@pytest.fixture
def loads(tmp_path: Path) -> Iterator[tuple[dict[str, str], CompositeLoadFrame]]:
    """The answers of a device that takes loads, by question, and its load frame."""
    path = tmp_path / "loads.yaml"
    path.write_text(TAKES_LOADS, encoding="utf-8")
    answers = {"f": "+0.0 S", "t": "0.0", "v": "1.00"}

    def answer(line: str) -> str:
        if line[0] in "rg":
            answers["v" if line[0] == "r" else "t"] = line[1:]
        return f"{answers[line]}\r\n" if line in answers else ""

    with over_text(answer) as line:
        frame = open_load_frame({"map": str(path), "serial": {"port": line, "slowest_s": 0.05}}, CLOCK)
        yield answers, frame
        frame.close()


@pytest.mark.parametrize(
    ("question", "answer", "sentence"),
    [("t", "20.0", "its aim is 20 N, 100 N was ordered"), ("v", "9.99", "its rate is 9.99 N/s, 5 N/s was ordered")],
)
def test_target_and_rate_that_somebody_changes_are_noticed(
    loads: tuple[dict[str, str], CompositeLoadFrame], question: str, answer: str, sentence: str
) -> None:
    answers, frame = loads
    assert [frame.read().order_changed for _ in range(2)] == [None] * 2
    frame.ramp_to(100.0, 5.0)
    assert [frame.read().order_changed for _ in range(4)] == [None] * 4
    answers[question] = answer
    assert any(sentence in str(frame.read().order_changed) for _ in range(2))
    frame.stop()
    frame.ramp_to(100.0, 5.0)
    assert [frame.read().order_changed for _ in range(4)] == [None] * 4


def test_an_order_of_an_earlier_process_is_compared(loads: tuple[dict[str, str], CompositeLoadFrame]) -> None:
    answers, frame = loads
    answers.update(t="100.0", v="5.00")
    frame.recall_order(100.0, 5.0)
    assert [frame.read().order_changed for _ in range(4)] == [None] * 4
    answers["t"] = "0.0"
    assert any("its aim is 0 N, 100 N was ordered" in str(frame.read().order_changed) for _ in range(2))


def test_an_answer_that_the_description_does_not_fit_is_not_compared_and_costs_no_reading(
    loads: tuple[dict[str, str], CompositeLoadFrame],
) -> None:
    answers, frame = loads
    frame.ramp_to(100.0, 5.0)
    answers["v"] = "fast"
    assert [frame.read().order_changed for _ in range(4)] == [None] * 4
    answers["t"] = "20.0"
    assert frame.read().order_changed is not None


def test_a_dialogue_may_state_further_stops_and_the_ends_of_a_sensor(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    more = ["ranges: {force: [-500, 500]}", 'other_stops: [{says: power off, steps: [{send: "o\\r"}]}]']
    text = ["protocol: ascii", "name: mine", "source: mine", "asks: {load: {send: \"f\\r\", reply: '(?P<force>[-+]?[0-9.]+)'}}"]
    path.write_text("\n".join([*text, "every_turn: [load]", *more]), encoding="utf-8")
    heard, load = [], ["+500.0\r\n"]

    def answer(line: str) -> str:
        heard.append(line)
        return load[0] if line == "f" else ""

    with over_text(answer) as line:
        settings = {"map": str(path), "serial": {"port": line, "slowest_s": 0.05}}
        with pytest.raises(LinkError, match=r"force is at the end of its range \(500\): the sensor is saturated"):
            open_load_frame(settings, CLOCK)
        load[0] = "+499.9\r\n"
        frame = open_load_frame(settings, CLOCK)
        assert isinstance(frame, StopMethods)
        assert frame.stop_methods == ("power off",)
        frame.stop_by(0)
        wait_until(lambda: "o" in heard)
        frame.close()
