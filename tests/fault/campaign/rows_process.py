"""Faults 42 to 55: the daemon itself, its disk, its clock, its computer."""

from __future__ import annotations

import os
import re
import resource
import signal
import struct
import time
import zlib

from lab import Lab, until
from link_states import SOON_MS, WATCHDOG_MS, in_fault, ramping, stopped
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader
from table import Kind, Observation, Row

_UNLIMITED = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)


def killed(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"] |= {"loads_n": [400.0, 420.0], "hold_s": 2.0}
    took, done = [], []
    for state in ("ramping", "settling", "holding", "imaging"):
        count, recoveries = lab.states().count(state), lab.states().count("recover")
        lab.start(*(["--resume"] if lab.log.is_dir() else []), attended=True)
        _until_again(lab, state, count, recoveries)
        if state == "ramping":
            until(lambda: lab.stand.moving, "the stand moves")
        began = time.monotonic()
        moved = lab.stand.moving
        lab.daemon.kill()
        lab.daemon.communicate()
        took.append(lab.stopped_ms(began) if moved else 0.0)
        done.append(state)
    assert max(took) <= WATCHDOG_MS
    count, recoveries = lab.states().count("imaging"), lab.states().count("recover")
    lab.start("--resume", attended=True)
    _until_again(lab, "imaging", count, recoveries)
    time.sleep(0.6)
    for pair in (1, 2):
        for _ in range(2):
            lab.frame()
            time.sleep(0.7)
        until(lambda pair=pair: len(lab.logged("/pair")) == pair, f"pair {pair}")
        if pair == 1:
            count = lab.states().count("imaging")
            until(lambda count=count: lab.states().count("imaging") > count, "imaging of the second step")
            time.sleep(0.6)
    code, output = lab.end()
    assert code == 0, output
    assert [entry["pair"] for entry in lab.logged("/pair")] == [0, 1]
    return Observation(f"killed while {', '.join(done)}; resumed each time, the step repeated; both pairs once", max(took))


def _until_again(lab: Lab, state: str, count: int, recoveries: int) -> None:
    """Until a state is reached again; a question whether to continue is confirmed."""
    end_s = time.monotonic() + 150.0
    while lab.states().count(state) <= count:
        assert time.monotonic() < end_s, f"not in {state} again: {lab.states()[-6:]}"
        if lab.states().count("recover") > recoveries:
            recoveries += 1
            lab.enter("resume")
        time.sleep(0.05)


def terminated(lab: Lab) -> Observation:
    took = []
    for state in ("ramping", "holding", "imaging"):
        trial = Lab(lab.folder / state, lab.stand)
        trial.over_tcp()
        trial.config["protocol"]["hold_s"] = 2.0
        lab.stand.force_n = 0.0
        try:
            trial.start().reach(state)
            if state == "ramping":
                until(lambda: lab.stand.moving, "the stand moves")
            moved, began = lab.stand.moving, time.monotonic()
            trial.daemon.send_signal(signal.SIGTERM)
            code, output = trial.end()
            assert code == 1, output
            took.append(trial.stopped_ms(began) if moved else 0.0)
            trial.require_complete_log()
        finally:
            for process in trial.started:
                if process.poll() is None:
                    process.kill()
    assert max(took) <= SOON_MS, took
    return Observation("stopping, aborted, log finished, exit code 1, in each state", max(took))


def torn_log(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"]["hold_s"] = 30.0
    lab.start().reach("holding")
    time.sleep(1.5)
    lab.daemon.kill()
    lab.daemon.communicate()
    (part,) = lab.log.glob("*.part")
    samples = len(lab.logged("/load_frame/sample"))
    data = part.read_bytes()
    part.write_bytes(data[: len(data) - 3000] + bytes(4096))
    lab.config["protocol"]["hold_s"] = 30.0
    lab.start("--resume", "--yes")
    until(lambda: lab.states().count("holding") > 1, "the hold of the run that was taken up")
    lab.daemon.send_signal(signal.SIGINT)
    code, _ = lab.end()
    assert code == 1
    stored = len([entry for entry in lab.logged("/load_frame/sample")])
    assert stored > samples * 0.8
    lab.require_complete_log()
    return Observation("recovered, the damaged original kept in the same folder, resumed with the complete hold")


def blocked_loop(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"] |= {"loads_n": [800.0], "ramp_rate_n_s": 20.0}
    lab.config["load_frame"]["settings"]["watchdog_s"] = 0.0
    began = ramping(lab)
    lab.daemon.send_signal(signal.SIGUSR1)
    took_ms = stopped(lab, began, 3000.0, "stop")
    return Observation(in_fault(lab, "control sent no signal"), took_ms)


def full_disk(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"] |= {"loads_n": [800.0], "ramp_rate_n_s": 20.0}
    lab.start(attended=True).reach("ramping")
    until(lambda: lab.stand.moving, "the stand moves")
    (part,) = lab.log.glob("*.part")
    began = time.monotonic()
    resource.prlimit(lab.daemon.pid, resource.RLIMIT_FSIZE, (part.stat().st_size + 2000, resource.RLIM_INFINITY))
    took_ms = stopped(lab, began, 8000.0, "stop")
    time.sleep(1.0)
    resource.prlimit(lab.daemon.pid, resource.RLIMIT_FSIZE, _UNLIMITED)
    until(lambda: "keeps up again" in lab.reported(), "the log keeps up again")
    assert lab.states()[-1] == "paused"
    lab.enter("resume")
    lab.reach("ramping", 2)
    lab.daemon.send_signal(signal.SIGINT)
    lab.end()
    lab.require_complete_log()
    return Observation("paused, motion held; when there was room everything was written, and the operator resumed", took_ms)


def moved_log(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"]["hold_s"] = 20.0
    lab.start().reach("holding")
    (part,) = lab.log.glob("*.part")
    away = part.with_name("rotated.1")
    part.rename(away)
    time.sleep(4.0)
    lab.daemon.send_signal(signal.SIGINT)
    code, output = lab.end()
    assert code == 1
    assert "moved or removed the log" in output, output
    assert away.stat().st_size > 0
    reports = "could not be finished" in output or (lab.log / "run.000.mcap").exists()
    assert reports, output
    return Observation(
        "paused within 4 s, with the reason; writing continued in the renamed file; at the end: the log could not be finished"
    )


def edited_config(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"]["hold_s"] = 30.0
    lab.start().reach("holding")
    lab.config["protocol"]["loads_n"] = [800.0]
    path = lab.folder / "run.yaml"
    path.write_text(path.read_text(encoding="utf-8").replace("400.0", "800.0"), encoding="utf-8")
    time.sleep(1.0)
    assert lab.states()[-1] == "holding"
    assert lab.stand.target_n == 400.0
    lab.daemon.send_signal(signal.SIGINT)
    lab.end()
    code, output = lab.start("--resume", "--yes").end()
    assert code == 2, output
    assert "loads_n" in output, output
    return Observation("nothing changed in the run; resuming with another plan is refused with the key (exit code 2)")


def two_at_once(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"]["hold_s"] = 600.0  # longer than two more daemons take to be refused on a busy computer
    lab.start().reach("holding")
    first = lab.daemon
    output = []
    for options in ((), ("--resume",)):
        code, text = lab.start(*options).end()
        assert code == 2, text
        output.append(text)
    assert "in use" in output[1] or "another" in output[1] or "already" in output[1], output
    lab.started.append(first)
    assert lab.states()[-1] == "holding"
    lab.daemon.send_signal(signal.SIGINT)
    lab.end()
    lab.require_complete_log()
    shown = output[1].replace(f"{lab.folder}/", "")
    return Observation(f"refused (exit code 2): {shown[:160]}")


def still_moving(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"] |= {"loads_n": [800.0], "ramp_rate_n_s": 5.0}
    lab.config["load_frame"]["settings"]["watchdog_s"] = 0.0
    ramping(lab)
    lab.daemon.kill()
    lab.daemon.communicate()
    assert lab.stand.moving
    requests = len(lab.stand.requests)
    lab.start("--resume", "--yes")
    began = start = time.monotonic()
    while len(lab.stand.requests) == requests:  # more closely than `until` looks: the stop may come at once
        began = time.monotonic()
        assert began < start + 60.0, "the device is queried within a minute"
        time.sleep(0.001)
    took_ms = stopped(lab, began, 1000.0, "stop")
    code, output = lab.end()
    assert code == 1, output
    assert "moved before a motion was ordered" in f"{output} {lab.reported()}", output
    return Observation("it was stopped at the first reading that showed motion; not resumed automatically", took_ms)


def jumping_clock(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"]["hold_s"] = 8.0
    lab.start().reach("holding")
    began = time.monotonic()
    lab.daemon.send_signal(signal.SIGUSR2)
    lab.reach("imaging")
    held_s = time.monotonic() - began
    assert held_s > 7.0, held_s
    states = lab.logged("/state")
    settled, over = (next(trial for trial in states if trial["cause"] == cause) for cause in ("settled", "hold_over"))
    assert over["time_ns"] - settled["time_ns"] >= 8e9
    lab.daemon.send_signal(signal.SIGINT)
    lab.end()
    lab.require_complete_log()
    return Observation(f"the hold of 8 s lasted {(over['time_ns'] - settled['time_ns']) / 1e9:.2f} s")


def suspended(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"] |= {"loads_n": [800.0], "ramp_rate_n_s": 10.0}
    lab.config["load_frame"]["settings"]["watchdog_s"] = 0.0
    ramping(lab)
    lab.daemon.send_signal(signal.SIGSTOP)
    time.sleep(5.0)
    began = time.monotonic()
    lab.daemon.send_signal(signal.SIGCONT)
    took_ms = stopped(lab, began, 1000.0, "stop")
    return Observation(in_fault(lab, "control sent no signal"), took_ms)


def read_meanwhile(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"]["hold_s"] = 4.0
    lab.start().reach("holding")
    (part,) = lab.log.glob("*.part")
    looks, most = 0, 0
    while lab.states()[-1] == "holding":
        with part.open("rb") as stream:
            count = 0
            try:
                for _ in StreamReader(stream).records:
                    count += 1
            except (McapError, EOFError, struct.error):
                pass
        looks, most = looks + 1, max(most, count)
        os.chmod(part, 0o444)
    lab.daemon.send_signal(signal.SIGINT)
    code, _ = lab.end()
    assert code == 1
    lab.require_complete_log()
    assert most > 50
    return Observation(f"another maker's reader opened it {looks} times and read up to {most} records; the run and its log are complete")


def bombs(lab: Lab) -> Observation:
    lab.no_frame()
    lab.start().reach("imaging")
    time.sleep(0.6)

    def child() -> int:
        return int(open(f"/proc/{lab.daemon.pid}/task/{lab.daemon.pid}/children", encoding="ascii").read().split()[0])

    def peak_mb(pid: int) -> float:
        with open(f"/proc/{pid}/status", encoding="ascii") as status:
            return int(re.search(r"VmHWM:\s+(\d+)", status.read())[1]) / 1024  # type: ignore[index]

    analysis = child()
    before = {pid: peak_mb(pid) for pid in (lab.daemon.pid, analysis)}
    (lab.export / "bomb.png").write_bytes(_png(16_384, 16_384))
    (lab.export / "huge.png").write_bytes(_png(100_000, 100_000, rows=10))
    for name in ("bomb.png", "huge.png"):
        until(
            lambda name=name: any(entry["name"] == name and entry["decision"] == "refused" for entry in lab.logged("/sem/file")), name, 60
        )
    grown = {name: peak_mb(pid) - before[pid] for name, pid in (("control", lab.daemon.pid), ("analysis", analysis)) if child() == analysis}
    assert all(value < 600 for value in grown.values()), grown
    for _ in range(2):
        lab.frame()
        time.sleep(0.7)
    code, output = lab.end()
    assert code == 0, output
    lab.require_complete_log()
    reasons = [entry["reason"] for entry in lab.logged("/sem/file") if entry["name"] in ("bomb.png", "huge.png")]
    return Observation(f"{' '.join(reasons)[:200]} Memory grew by at most {max(grown.values(), default=0.0):.0f} MB; the run went on")


def _png(width: int, height: int, rows: int | None = None) -> bytes:
    """A picture of zeros that is small as a file."""
    packer = zlib.compressobj(9)
    line = bytes(width + 1)
    data = b"".join(packer.compress(line) for _ in range(height if rows is None else rows)) + packer.flush()

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


R, E = Kind.REAL, Kind.EMULATED
ROWS = (
    Row(
        42,
        "kill -9 while ramping, settling, holding, imaging",
        "the device's watchdog stops it; resumed, nothing lost or repeated",
        R,
        killed,
    ),
    Row(43, "SIGTERM while ramping, holding, imaging", "stopped, log finished", R, terminated),
    Row(44, "kill -9, then the end of the log cut off and a page of zeros", "recovered and resumed", E, torn_log),
    Row(45, "the event loop is blocked for 5 s in a ramp", "the link's own thread stops the machine; fault", R, blocked_loop, short=True),
    Row(46, "the disk is full in a ramp, and has room again later", "paused; everything is written; the operator resumes", R, full_disk),
    Row(47, "a log rotator renames the log while it is written", "reported, paused; nothing is lost", R, moved_log),
    Row(48, "the configuration is edited in the run", "no change; another plan is refused when the run is resumed", R, edited_config),
    Row(49, "a second daemon, with and without --resume", "refused; the first is not disturbed", R, two_at_once),
    Row(
        50,
        "kill -9 in a ramp of a machine without watchdog, then resumed",
        "stopped at the first reading; the operator decides",
        R,
        still_moving,
    ),
    Row(51, "the computer's clock jumps by an hour in a hold", "the hold lasts as long as it must", E, jumping_clock),
    Row(52, "the computer sleeps for 5 s in a ramp (SIGSTOP), no watchdog in the device", "stopped when it wakes; fault", E, suspended),
    Row(54, "another reader opens the log again and again while it is written", "both continue", R, read_meanwhile),
    Row(
        55,
        "a picture of 16,384 x 16,384 px of zeros, and a header of 100,000 x 100,000",
        "refused; memory bounded; the run continues",
        R,
        bombs,
    ),
)
