"""Faults 1 to 25: the link to the load frame, and the frame itself."""

from __future__ import annotations

import itertools
import math
import os
import re
import signal
import time
from pathlib import Path

import serial
import yaml
from lab import Lab, until
from stand import FAULT, RtuPort
from table import Kind, Observation, Row

SOON_MS = 400.0
"""Largest time from a reading beyond a limit to rest: one polling period (50 ms), the stop, and a busy computer."""
WATCHDOG_MS = 2600.0
"""Largest time to rest by the watchdog of the device (2 s), fed up to 0.1 s before, on a busy computer."""


def in_fault(lab: Lab, pattern: str, *, after: str = "ramping") -> str:
    """Require that the run went into a fault and ended by itself; returns the message."""
    code, output = lab.end()
    states = lab.states()
    assert code == 1, output
    assert "fault" in states or "estopped" in states, states
    assert after in states
    reported = f"{output} | {lab.reported()}"
    assert re.search(pattern, reported), reported
    lab.require_complete_log()
    assert not lab.logged("/pair")
    return next((fault["what"] for fault in lab.logged("/fault") if re.search(pattern, fault["what"])), _message(output, pattern))


def _message(output: str, pattern: str) -> str:
    """The message in the output, between the marks of warnings and the progress lines."""
    match = re.search(rf"! ([^!]*{pattern}[^!:]*)", output)
    return match[1].strip() if match else pattern


def ramping(lab: Lab) -> float:
    """Start the daemon and wait until the stand moves; returns the time (monotonic s)."""
    lab.start().reach("ramping")
    until(lambda: lab.stand.moving and abs(lab.stand.force_n) > 20, "the stand moves")
    return time.monotonic()


def stopped(lab: Lab, since_s: float, within_ms: float, by: str) -> float:
    took_ms = lab.stopped_ms(since_s)
    assert took_ms <= within_ms, f"it took {took_ms:.0f} ms"
    why = next(why for at_s, why in lab.stand.stops if at_s >= since_s)
    assert re.search(by, why), why
    return took_ms


def cable_out_in_ramp(lab: Lab) -> Observation:
    port = lab.over_tcp()
    began = ramping(lab)
    port.disconnect()
    took_ms = stopped(lab, began, WATCHDOG_MS, "its own watchdog")
    return Observation(in_fault(lab, "no device answers|is closed|gave no answer|link"), took_ms)


def cable_out_in_hold(lab: Lab) -> Observation:
    lab.config["protocol"]["hold_s"] = 30.0
    port = lab.over_tcp()
    lab.start().reach("holding")
    port.disconnect()
    return Observation(in_fault(lab, "no device answers|gave no answer", after="holding"))


def cable_out_in_stop(lab: Lab) -> Observation:
    port = lab.over_tcp()
    began = ramping(lab)
    port.disconnect()
    lab.daemon.send_signal(signal.SIGINT)
    took_ms = stopped(lab, began, WATCHDOG_MS, "its own watchdog")
    code, output = lab.end()
    assert code == 1
    assert "did not confirm" in output, output
    lab.require_complete_log()
    return Observation("stopping, then aborted: the load frame did not confirm that it stopped", took_ms)


def hung(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"]["loads_n"] = [800.0]
    began = ramping(lab)
    lab.stand.silent = True
    took_ms = stopped(lab, began, WATCHDOG_MS, "its own watchdog")
    return Observation(in_fault(lab, "gave no answer within"), took_ms)


def late_answers(lab: Lab) -> Observation:
    lab.over_rtu()
    lab.config["protocol"]["loads_n"] = [800.0]
    ramping(lab)
    late = [0.45] * 3
    lab.stand.late_s = lambda: late.pop(0) if late else 0.0
    code, _ = lab.end()
    lab.require_complete_log()
    raws = [tuple(entry["raw"]) for entry in lab.logged("/load_frame/sample")]
    counts = [raw[7] << 16 | raw[8] for raw in raws]
    assert code == 1
    assert all(a < b for a, b in itertools.pairwise(counts)), "a reading was older than the one before it"
    assert {len(raw) for raw in raws} == {13}
    assert not late
    return Observation(f"no stale reading among {len(raws)}; the machine was stopped and the run ended in a fault")


def noise(lab: Lab) -> Observation:
    lab.over_rtu()
    lab.config["protocol"]["hold_s"] = 30.0
    lab.start().reach("holding")
    bad = [
        *(lambda frame: [(0.0, frame[:-1] + bytes([frame[-1] ^ 0x55]))] for _ in range(2)),
        *(lambda frame: [(0.0, frame[:7]), (0.03, frame[7:])] for _ in range(2)),
        *(lambda frame: [(0.0, b"\xc3\x5a" + frame)] for _ in range(2)),
        *(lambda frame: [(0.0, frame + frame)] for _ in range(2)),
        *(lambda frame: [(0.0, b"\x01\x04\x00\x03\x00\x0d" + frame)] for _ in range(2)),
    ]
    replies = [0]

    def corrupt(frame: bytes) -> list[tuple[float, bytes]]:
        replies[0] += 1
        return bad.pop(0)(frame) if bad and replies[0] % 5 == 0 else [(0.0, frame)]

    lab.stand.corrupt = corrupt
    until(lambda: not bad, "all corrupted answers were sent")
    time.sleep(0.5)
    forces = [entry["force_n"] for entry in lab.logged("/load_frame/sample")]
    assert all(-1.0 <= force <= 401.0 for force in forces)
    assert "fault" not in lab.states(), lab.reported()
    lab.daemon.send_signal(signal.SIGINT)
    code, _ = lab.end()
    assert code == 1
    lab.require_complete_log()
    return Observation(f"10 corrupted answers cost no wrong reading of {len(forces)}, and no fault: the hold continued")


def refusals(lab: Lab) -> Observation:
    lab.over_tcp()
    codes: list[str] = []
    for code in (1, 2, 3, 4, 6):
        lab.config["run"]["name"] = f"refused{code}"
        trial = Lab(lab.folder / f"e{code}", lab.stand)
        trial.config |= {key: lab.config[key] for key in ("load_frame", "limits", "protocol")}
        lab.stand.refuse_motion = code
        trial.start()
        try:
            ended, output = trial.end()
            assert ended == 1, output
            assert f"exception {code}" in output, output
            assert "fault" in trial.states()
            assert not lab.stand.stops
            codes.append(str(code))
        finally:
            lab.stand.refuse_motion = 0
            for process in trial.started:
                if process.poll() is None:
                    process.kill()
    return Observation(f"the order was refused with exception {', '.join(codes)}: fault each time, and nothing moved")


def wrong_unit(lab: Lab) -> Observation:
    lab.over_rtu()
    lab.config["load_frame"]["settings"]["unit"] = 3
    code, output = lab.start().end()
    assert code == 2, output
    assert "unit 3 gave no answer" in output, output
    assert not lab.stand.requests
    return Observation("refused at the start (exit code 2): unit 3 gave no answer; nothing was written")


def word_order(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.stand.sensor = lambda force_n: force_n + 99.25
    lab.config["load_frame"]["settings"]["registers"] = {"force": {"words": "low_first"}}
    code, output = lab.start().end()
    assert code in (1, 2), output
    assert not [entry for entry in lab.logged("/command") if entry["what"] == "ramp_to"]
    assert "order of words" in f"{output} {lab.reported()}", output
    return Observation("refused at the start: the force is no number that a device sends, check the order of words; nothing moved")


def renamed_adapter(lab: Lab) -> Observation:
    port = lab.over_rtu()
    name = lab.folder / "semlive-frame"
    name.symlink_to(port.path)
    lab.config["load_frame"]["settings"]["serial"]["port"] = str(name)
    lab.config["protocol"]["hold_s"] = 60.0
    lab.start(attended=True).reach("holding")
    port.unplug()
    until(lambda: "fault" in lab.states(), "the link is lost")
    again = RtuPort(lab.stand)
    other = lab.folder / "new"
    other.symlink_to(again.path)
    os.replace(other, name)
    before = len(lab.logged("/load_frame/sample"))
    until(lambda: len(lab.logged("/load_frame/sample")) > before + 5, "readings come again")
    lab.enter("resume")
    lab.reach("recover").enter("resume")
    lab.reach("holding", 2)
    lab.daemon.send_signal(signal.SIGINT)
    lab.end()
    lab.require_complete_log()
    return Observation(
        "fault; the new line was opened by its name, its identity was checked, and the operator resumed the step with its full hold"
    )


def held_port(lab: Lab) -> Observation:
    port = lab.over_rtu()
    with serial.Serial(port.path, exclusive=True):
        code, output = lab.start().end()
    assert code == 2, output
    assert "cannot be opened" in output, output
    assert "who else uses it" in output, output
    return Observation("refused at the start (exit code 2): the line cannot be opened, check who else uses it")


def reboot(lab: Lab) -> Observation:
    lab.config["protocol"]["hold_s"] = 60.0
    port = lab.over_tcp()
    lab.start().reach("holding")
    port.disconnect()
    lab.stand.reboot()
    port.reconnect()
    return Observation(in_fault(lab, "was restarted", after="holding"))


def nonsense_readings(lab: Lab) -> Observation:
    lab.over_tcp()
    took, messages = [], []
    cases = {"NaN": math.nan, "-999": -999.0, "saturated": 32_767.0, "frozen": None}
    for name, value in cases.items():
        trial = Lab(lab.folder / name, lab.stand)
        trial.config |= {key: lab.config[key] for key in ("load_frame", "limits", "protocol")}
        lab.stand.force_n, lab.stand.word, lab.stand.trouble = 0.0, None, 0
        try:
            began = ramping(trial)
            if value is None:
                lab.stand.frozen = True
            else:
                lab.stand.sensor = lambda _, value=value: value
            took.append(stopped(trial, began, 1700.0 if value is None else SOON_MS * 2, "stop"))
            messages.append(in_fault(trial, "which is no reading|outside the limits|is frozen"))
        finally:
            lab.stand.sensor, lab.stand.frozen = (lambda force_n: force_n), False
            for process in trial.started:
                if process.poll() is None:
                    process.kill()
    return Observation("; ".join(f"{name}: fault, {took_ms:.0f} ms" for name, took_ms in zip(cases, took, strict=True)), max(took))


def never_stable(lab: Lab) -> Observation:
    lab.over_tcp()
    bench = Path(__file__).parents[3] / "drivers" / "semlive_drivers" / "maps" / "bench.yaml"
    text = yaml.safe_load(bench.read_text(encoding="utf-8"))
    text["points"]["stable"] = {"kind": "input", "address": 300}
    text["every_turn"].append(["stable"])
    text["valid"] = [{"point": "stable", "bit": 2, "equals": 1, "says": "the reading is not stable"}]
    path = lab.folder / "map.yaml"
    path.write_text(yaml.safe_dump(text), encoding="utf-8")
    lab.config["load_frame"]["settings"]["map"] = str(path)
    code, output = lab.start().end()
    assert code in (1, 2), output
    assert "the reading is not stable" in output, output
    assert not [entry for entry in lab.logged("/command") if entry["what"] == "ramp_to"]
    return Observation("refused at the start: the reading is not stable; nothing moved")


def sign_flip(lab: Lab) -> Observation:
    lab.over_tcp(force_drop_max_n=60.0)
    lab.config["protocol"]["loads_n"] = [800.0]
    began = ramping(lab)
    until(lambda: lab.stand.force_n > 120.0, "the load is 120 N")
    began = time.monotonic()
    lab.stand.sensor = lambda force_n: force_n - 120.0  # tared
    took_ms = stopped(lab, began, SOON_MS, "stop")
    return Observation(in_fault(lab, "fell"), took_ms)


def stuck(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.stand.stuck = True
    lab.start().reach("ramping")
    return Observation(in_fault(lab, "the load reading does not show it"))


def wrong_way(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.stand.wrong_way = True
    lab.start().reach("ramping")
    fault = in_fault(lab, "on its way to")
    assert lab.stand.force_n > -50.0  # stopped before the limit
    return Observation(fault)


def creep(lab: Lab) -> Observation:
    lab.config["protocol"]["hold_s"] = 20.0
    lab.over_tcp()
    lab.start().reach("holding")
    lab.stand.creep_n_s = 15.0
    fault = in_fault(lab, "while nothing was ordered")
    assert not lab.logged("/pair")
    return Observation(fault)


def fracture(lab: Lab) -> Observation:
    lab.over_tcp(force_drop_max_n=60.0)
    lab.config["protocol"]["loads_n"] = [800.0]
    ramping(lab)
    until(lambda: lab.stand.force_n > 120.0, "the load is 120 N")
    began = time.monotonic()
    lab.stand.sensor = lambda force_n: 0.0
    took_ms = stopped(lab, began, SOON_MS, "stop")
    return Observation(in_fault(lab, "fell"), took_ms)


def limit_switch(lab: Lab) -> Observation:
    lab.over_tcp()
    ramping(lab)
    lab.stand.halt("limit switch")
    lab.stand.word, lab.stand.trouble = FAULT, 3
    return Observation(in_fault(lab, "limit switch"), 0.0)


def soft_limit(lab: Lab) -> Observation:
    lab.over_tcp(extension_max_mm=0.01)
    ramping(lab)
    until(lambda: lab.stand.force_n > 200.0, "the limit is passed")
    took_ms = stopped(lab, time.monotonic() - 0.01, SOON_MS, "stop")
    return Observation(in_fault(lab, "outside the limits"), took_ms)


def emergency_stop(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.start(attended=True).reach("ramping")
    until(lambda: lab.stand.moving, "the stand moves")
    lab.stand.halt("emergency stop")
    lab.stand.word, lab.stand.trouble = FAULT, 4
    lab.reach("estopped")
    lab.stand.word, lab.stand.trouble = None, 0
    time.sleep(1.0)
    assert not lab.stand.moving
    assert lab.states()[-1] == "estopped"
    lab.enter("resume")
    lab.reach("recover")
    assert not lab.stand.moving
    lab.enter("resume")
    lab.reach("ramping", 2)
    lab.daemon.send_signal(signal.SIGINT)
    lab.end()
    lab.require_complete_log()
    return Observation("estopped; released, nothing moved until the operator resumed twice", 0.0)


def device_watchdog(lab: Lab) -> Observation:
    lab.over_tcp()
    began = ramping(lab)
    lab.daemon.send_signal(signal.SIGSTOP)
    took_ms = stopped(lab, began, WATCHDOG_MS, "its own watchdog")
    lab.daemon.send_signal(signal.SIGCONT)
    return Observation(in_fault(lab, "watchdog|control sent no signal|fault"), took_ms)


def heartbeat_stuck(lab: Lab) -> Observation:
    lab.over_tcp()
    lab.config["protocol"]["loads_n"] = [800.0]
    began = ramping(lab)
    lab.stand.heart_stuck = True
    took_ms = stopped(lab, began, WATCHDOG_MS, "its own watchdog")
    return Observation(in_fault(lab, "watchdog"), took_ms)


def by_hand(lab: Lab) -> Observation:
    lab.config["protocol"]["hold_s"] = 20.0
    lab.over_tcp()
    lab.start().reach("holding")
    lab.stand.move(340.0, 30.0)
    return Observation(in_fault(lab, "its own target is 340 N"))


E, R = Kind.EMULATED, Kind.REAL
ROWS = (
    Row(
        1,
        "the load frame's cable out in a ramp: connections break, none is accepted",
        "the device's watchdog stops it; fault",
        E,
        cable_out_in_ramp,
    ),
    Row(2, "cable out in a hold", "fault; the hold does not count", E, cable_out_in_hold),
    Row(
        3,
        "cable out while stopping",
        "the device's watchdog stops it; aborted, with the message that the stop was not confirmed",
        E,
        cable_out_in_stop,
    ),
    Row(4, "the device accepts connections and never answers", "the device's watchdog stops it; fault", E, hung, short=True),
    Row(5, "answers over RTU come after the time-out", "no reading is that of an earlier request; stop, fault", E, late_answers),
    Row(6, "wrong CRC, split, noise before, twice, echo of the request, over RTU", "no wrong reading; recovered without a fault", E, noise),
    Row(7, "an order is refused with exception 1, 2, 3, 4, 6", "fault, named; nothing moves", E, refusals),
    Row(8, "wrong unit number over RTU", "refused at the start, nothing is written", E, wrong_unit),
    Row(9, "words swapped in the register map", "refused before anything moves", E, word_order),
    Row(
        10,
        "the serial adapter is pulled and comes back as another device",
        "fault; link back by its lasting name, operator resumes",
        E,
        renamed_adapter,
    ),
    Row(11, "another program holds the serial port", "refused at the start, with the reason", R, held_port),
    Row(12, "the device is switched off and on in a hold: counters and position start again", "fault, named", E, reboot),
    Row(13, "force is NaN, -999, saturated, frozen", "stop; fault", E, nonsense_readings),
    Row(14, "the device never reports a stable reading", "refused before anything moves", E, never_stable),
    Row(15, "tare in the middle of a ramp", "stop; fault", E, sign_flip),
    Row(16, "an order is accepted and nothing moves", "stop; fault", E, stuck),
    Row(17, "the motor goes the wrong way", "stop before the limit; fault", E, wrong_way),
    Row(18, "the load creeps out of tolerance in the hold", "stop; fault; no pair", E, creep),
    Row(19, "the specimen breaks", "stop; fault", E, fracture),
    Row(20, "limit switch", "emergency; fault", E, limit_switch),
    Row(21, "a soft limit in a ramp", "stop; fault", E, soft_limit),
    Row(22, "emergency stop pressed, then released", "estopped; nothing moves until the operator resumes", E, emergency_stop),
    Row(
        23,
        "the daemon is suspended (SIGSTOP) and does not feed the device's watchdog",
        "the device stops by itself; fault when the daemon continues",
        R,
        device_watchdog,
    ),
    Row(24, "the heartbeat register does not take what is written", "the device stops by itself; fault", E, heartbeat_stuck),
    Row(25, "somebody moves the frame from its panel in a hold", "stop; fault; no pair", E, by_hand),
)
