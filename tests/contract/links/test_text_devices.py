"""Other devices that speak text: an amplifier as its public drivers describe it, one with checksums, and one that takes loads."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.ports import StopMethods
from semlive_drivers.composite_load_frame import CompositeLoadFrame
from semlive_drivers.text.codec import CheckKind, Checksum, fill_template, with_check, without_check
from semlive_drivers.text.load_frame import open_load_frame

from ...clocks import MonotonicClock
from ...waiting import wait_until
from .text_server import over_text

CLOCK = MonotonicClock()


class Amplifier:
    """A load cell's amplifier at station 7."""

    def __init__(self) -> None:
        self.load, self.stat, self.asked = 1.234567, 0, []

    def __call__(self, line: str) -> str:
        self.asked.append(line)
        reported = {"STN?": 7.0, "SYS?": self.load, "STAT?": float(self.stat)}
        station, _, what = line.partition(":")
        return "" if station != "!007" else f"{reported[what]:+.6f}\r" if what in reported else "?\r"


def test_an_amplifier_reports_its_load_in_the_unit_of_the_configuration() -> None:
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
    assert not [requests for requests in amplifier.asked if "?" not in requests]


@pytest.mark.parametrize(
    ("name", "replies"),
    [
        ("mark10_gauge", ("-18.78 lbF\r\n", "4.285 N\r\n", "*10\r\n", "*11\r\n", "12.5 ozF\r\n")),
        ("imada_gauge", ("-083.54NTO\r", "+004.285NTH\r", "+012.3NPO\r", "+050.0NTE\r", "+012.3KTO\r")),
        ("mettler_sics", ("S S    -8.5187 kg\r\n", "S D  436.9484 g\r\n", "S I\r\n", "S +\r\n", "S -\r\n", "ES\r\n", "S S 1.0 oz\r\n")),
    ],
)
def test_a_gauge_reports_its_load_and_nothing_else_as_one(name: str, replies: tuple[str, ...]) -> None:
    present, requests = [replies[0]], list[str]()

    def answer(line: str) -> str:
        requests.append(line)
        return present[0]

    with over_text(answer) as path:
        frame = open_load_frame({"map": name, "serial": {"port": path, "slowest_s": 0.05}}, CLOCK)
        assert frame.read().force_n == pytest.approx(-83.54, abs=0.01)
        present[0] = replies[1]
        assert frame.read().force_n == pytest.approx(4.285)
        with pytest.raises(LinkError, match="cannot be moved by semlive"):
            frame.ramp_to(1.0, 1.0)
        for present[0] in replies[2:]:
            with pytest.raises(LinkError):
                frame.read()
        frame.close()
    assert {request.strip() for request in requests} == {{"mark10_gauge": "?C", "imada_gauge": "D", "mettler_sics": "SI"}[name]}


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
    requests = []

    def answer(line: str) -> str:
        requests.append(line)
        text = replies[min(len(requests), len(replies)) - 1]
        body, _, printed = text.partition("*")
        return (text if printed == "00" else with_check(body.encode(), Checksum(CheckKind.XOR, "*")).decode()) + "\r\n"

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
    assert set(requests) == {"RD*16"}


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
def test_what_is_wrong_in_a_dialogue_is_reported(tmp_path: Path, change: str, sentence: str) -> None:
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
    received, load = [], ["+500.0\r\n"]

    def answer(line: str) -> str:
        received.append(line)
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
        wait_until(lambda: "o" in received)
        frame.close()
