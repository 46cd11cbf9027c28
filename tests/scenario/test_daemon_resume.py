"""A daemon that is killed in the middle of a pair, and the same run resumed."""

from __future__ import annotations

import itertools
import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from threadpoolctl import threadpool_limits

from semlive.errors import BadConfig
from semlive.formats.log.messages import LoadSampleMessage
from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.messages import INPUT_TOPICS, READY_TEXT, is_output
from semlive.service.analysis.pipe import AnalysisReady, Heartbeat, read_message
from semlive.service.analysis.step import WorkerState, background_work, process_message
from semlive.service.config.configuration import load_config
from semlive.service.control.resume import read_previous_segments
from semlive.service.log.files import messages, segments

from ..waiting import RUN_END_S, logged

PAIRS = 3
HALF = 1
ATTEMPTS = 5
"""Wall seconds within which a run, or a part of it, ends on a busy computer; it decides nothing but when a test that hangs is given up."""
pytestmark = pytest.mark.timeout(4 * RUN_END_S)
IN_FAULT = 2  # docs/reference/bench-registers.md


def kill(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=30)


def is_half(found: dict[str, list[dict[str, Any]]]) -> bool:
    """The step of the half pair is imaged, and the scan of its first frame is in the log."""
    hold_over = [one["time_ns"] for one in found.get("/state", ()) if one["cause"] == "hold_over" and one["step"] == HALF]
    return bool(hold_over) and any(one["start_time_ns"]["value"] > hold_over[-1] for one in found.get("/sem/scan", ()))


class Missed(Exception):
    """The computer was too busy for a kill at the instant that the test is about: the run was further already."""


@pytest.fixture(autouse=True)
def sums_in_one_order() -> Iterator[None]:
    """As in the daemon's own analysis: with two threads for linear algebra the last bits differ."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(scope="module")
def resumed(instrument: Callable[..., Any], wait_until: Callable[..., None], watched: Callable[[Path], Any]) -> Any:
    """Killed while the second pair is half, resumed, killed before the last pair is analysed, and resumed again.

    Both instants last for less than a second. A kill that came after its instant is another case: then the run is started again.
    """
    for attempt in range(ATTEMPTS):
        try:
            one = killed_twice(instrument(f"killed{attempt}"), wait_until, watched)
        except Missed as missed:
            sys.stderr.write(f"{missed}\n")
        else:
            one.end_bench()
            return one
    raise AssertionError(f"in {ATTEMPTS} attempts no kill came at its instant")


def killed_twice(one: Any, wait_until: Callable[..., None], watched: Callable[[Path], Any]) -> Any:
    """The run of `resumed`; raises Missed if a kill came too late."""
    one.wait_for_slow_answers()
    one.config["protocol"].update(calibration_shifts_px=[[0, 0], [6, 0]], loads_n=[100])
    name, process = one.config["run"]["name"], one.start()
    watched(one.log).until(is_half, process, RUN_END_S)
    kill(process)
    assert [path.name for path in sorted(one.log.iterdir())] == [f"{name}.000.mcap.part"]
    one.before = logged(one.log, "/pair"), logged(one.log, "/sem/scan"), logged(one.log, "/load_frame/sample")
    if len(one.before[0]) > HALF:
        raise Missed("the pair was complete before the run was killed")
    # A computer on which the next daemon is there before the watchdog acts would keep it fed.
    wait_until(lambda: one.load_frame_status() == IN_FAULT, RUN_END_S)
    process, terminal = at_a_terminal(one)
    follower = watched(one.log)
    follower.until(lambda found: any(state["after"] == "recover" for state in found.get("/state", ())), process, RUN_END_S)
    time.sleep(0.5)
    one.unasked = logged(one.log, "/command")[len(logged_by(one.log, 0, "/command")) :]
    os.write(terminal, b"resume\n")
    follower.until(lambda found: len(found.get("/pair", ())) == PAIRS, process, RUN_END_S)
    kill(process)
    os.close(terminal)
    if len(logged(one.log, "/motion")) == PAIRS:
        raise Missed("the last pair was analysed before the run was killed")
    process = one.start("--resume", "--yes")
    out, err = process.communicate(timeout=RUN_END_S)
    assert process.returncode == 0, out + err
    return one


def at_a_terminal(one: Any) -> tuple[subprocess.Popen[str], int]:
    """The run resumed with an operator who can answer."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "semlive", "run", str(one.write_config()), "--no-page", "--resume"]
    process = subprocess.Popen(command, stdin=theirs, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True)
    os.close(theirs)
    return process, ours


def logged_by(log: Path, segment: int, topic: str) -> list[dict[str, Any]]:
    return logged(segments(log)[segment], topic)


def test_every_pair_is_there_once_and_the_half_one_is_taken_again(resumed: Any) -> None:
    pairs, before = logged(resumed.log, "/pair"), resumed.before[0]
    assert [one["pair"] for one in before] == [0]
    assert [one["pair"] for one in pairs] == list(range(PAIRS))
    assert pairs[:HALF] == before
    scanned_before = {one["export"] for one in resumed.before[1]}
    assert not scanned_before & {info["export"] for one in pairs[HALF:] for info in (one["first"], one["second"])}
    exports = [one["export"] for one in logged(resumed.log, "/sem/scan")]
    assert exports == sorted(set(exports))


def test_it_asks_and_the_step_is_entered_again_with_its_hold_in_full(resumed: Any) -> None:
    states = logged(resumed.log, "/state")
    again = next(at for at, one in enumerate(states) if one["after"] == "recover")
    assert [one["after"] for one in states[again : again + 3]] == ["recover", "ramping", "settling"]
    assert [one["step"] for one in states[again : again + 2]] == [HALF, HALF]
    # The bench's watchdog stopped it when the daemon died, and reports a fault until it gets a stop.
    assert {one["what"] for one in resumed.unasked} == {"stop"}
    assert any(f"begins step {HALF + 1} again" in one["text"] for one in logged(resumed.log, "/log"))
    settled = next(one["time_ns"] for one in states[again:] if one["cause"] == "settled")
    assert logged(resumed.log, "/pair")[HALF]["first"]["start_time_ns"]["value"] - settled >= 30e9
    # The stage's zero is that of the run's beginning, not where the run was taken up.
    moves = [one["args"] for one in logged(resumed.log, "/command") if one["what"] == "move_stage"]
    assert len(moves) == 3
    assert moves[0] == moves[1]
    assert moves[0]["x_um"] - moves[2]["x_um"] == pytest.approx(6 * resumed.config["sem"]["pixel_size_um"])


def test_the_next_segment_begins_with_the_state_of_the_run_and_time_continues(resumed: Any) -> None:
    first, second, third = segments(resumed.log)
    # The truncated segment is complete now; an original that was damaged stays next to it.
    assert [path.name for path in (first, second, third)] == [f"{resumed.log.name}.{number:03d}.mcap" for number in range(3)]
    head = [one for one in messages(second)][:3]
    assert [one.topic for one in head] == ["/run", "/snapshot", "/clock"]
    run, snapshot = (json.loads(one.payload) for one in head[:2])
    assert run["segment"] == snapshot["segment"] == 1
    assert run["config"] == logged(resumed.log, "/run")[0]["config"]
    assert (snapshot["state"], snapshot["next_step"], snapshot["pairs"]) == ("imaging", HALF, HALF)
    load, last = (LoadSampleMessage.model_validate(one) for one in (snapshot["load"], resumed.before[2][-1]))
    assert load == last
    assert snapshot["exports"] == max(one.sequence for one in messages(first) if one.topic == "/sem/original") + 1
    assert snapshot["inputs"] == sum(one.topic in INPUT_TOPICS for one in messages(first))
    over = logged(third, "/snapshot")[0]
    assert (over["next_step"], over["pairs"]) == (PAIRS, PAIRS)
    # It died before its last pair was analysed, and the last segment holds the missing results; it queried no device.
    assert over["pairs_analysed"] < PAIRS
    assert len(logged(third, "/dic/summary")) + len(logged(first, "/dic/summary")) + len(logged(second, "/dic/summary")) == 3 * PAIRS - 2
    assert logged(third, "/command") == logged(third, "/load_frame/sample") == []
    times = [one.log_time_ns for one in messages(resumed.log)]
    assert all(earlier < later for earlier, later in itertools.pairwise(times))


def analysed_again(log: Path) -> list[LogMessage]:
    """Analysis of the complete folder without a break."""
    count = sum(one.topic in INPUT_TOPICS for one in messages(log))
    command = [sys.executable, "-m", "semlive.service.analysis.worker", "--log", str(log), "--inputs", str(count)]
    stream = BytesIO(subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=RUN_END_S, check=True).stdout)
    outputs = []
    while (message := read_message(stream)) is not None:
        if not isinstance(message, Heartbeat):
            outputs.append(message.line if isinstance(message, AnalysisReady) else message)
    return outputs


def without_times(message: LogMessage) -> tuple[str, int, bytes]:
    """An output without what differs from one time to the next: how long it took, and what control added to a scan."""
    payload = message.payload
    if message.topic in ("/dic/summary", "/sem/scan"):
        fields = json.loads(payload)
        payload = json.dumps({key: value for key, value in fields.items() if not key.startswith(("wall_", "load_", "gage_"))}).encode()
    return message.topic, message.publish_time_ns, payload


def test_live_results_are_byte_for_byte_those_of_the_complete_folder_without_a_break(
    resumed: Any, semlive: Callable[..., tuple[int, str, str]]
) -> None:
    live = [one for one in messages(resumed.log) if is_output(one)]
    again = analysed_again(resumed.log)
    assert READY_TEXT in live[0].payload.decode()
    assert [without_times(one)[0::2] for one in live] == [without_times(one)[0::2] for one in again]
    code, out, err = semlive("replay", resumed.log, "--json")
    assert code == 0, err
    results = logged(resumed.log, "/result")
    result = results[-1]
    assert all(one == json.loads(out) for one in results)
    assert result["pairs"] == PAIRS


def test_for_every_truncation_of_the_log_the_outputs_of_analysis_are_determined(resumed: Any, tmp_path: Path) -> None:
    config = load_config(resumed.write_config())
    whole = segments(resumed.log)[0]
    state, outputs_before, after = WorkerState(), list[LogMessage](), [0]
    for one in messages(whole):
        if one.topic in INPUT_TOPICS:
            state, outputs = process_message(state, one)
            outputs_before.extend(outputs)
            state, outputs = background_work(state)
            outputs_before.extend(outputs)
            after.append(len(outputs_before))
    size = whole.stat().st_size
    most_outputs = 0
    for torn_at in range(size // 40, size, size // 20):
        folder = tmp_path / str(torn_at)
        folder.mkdir()
        torn = folder / f"{resumed.log.name}.000.mcap.part"
        torn.write_bytes(whole.read_bytes()[:torn_at])
        earlier = read_previous_segments(folder, config)
        stored = [one for one in messages(torn) if is_output(one)]
        assert [without_times(one)[0::2] for one in stored] == [without_times(one)[0::2] for one in outputs_before[: earlier.outputs]]
        assert earlier.outputs <= after[earlier.inputs]
        assert earlier.segment == 1
        most_outputs = max(most_outputs, earlier.outputs)
    assert most_outputs > 10


def test_a_run_that_is_complete_or_another_or_of_another_configuration_is_refused(resumed: Any) -> None:
    config = load_config(resumed.write_config())
    with pytest.raises(BadConfig, match="this run is complete"):
        read_previous_segments(resumed.log, config)
    other = config.model_copy(update={"protocol": config.protocol.model_copy(update={"hold_s": 25.0})})
    with pytest.raises(BadConfig, match=r"protocol.hold_s is 25.0 in the configuration and 30.0 in the log; a run continues with"):
        read_previous_segments(resumed.log, other)
    with pytest.raises(BadConfig, match="no such run to resume; leave --resume out"):
        read_previous_segments(resumed.log.with_name("no-such"), config)
