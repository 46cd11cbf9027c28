"""Faults 1 to 25: the link to the load frame, and the frame itself."""

from __future__ import annotations

import itertools
import os
import signal
import time

import serial
from lab import Lab, until
from link_states import WATCHDOG_MS, in_fault, ramping, stopped
from rows_load_frame import (
    by_hand,
    creep,
    device_watchdog,
    emergency_stop,
    fracture,
    heartbeat_stuck,
    limit_switch,
    never_stable,
    nonsense_readings,
    sign_flip,
    soft_limit,
    stuck,
    wrong_way,
)
from stand import RtuPort
from table import Kind, Observation, Row


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
