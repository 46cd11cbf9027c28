"""Faults 13 to 25: readings, limits and watchdog of the load frame."""

from __future__ import annotations

import math
import signal
import time
from pathlib import Path

import yaml
from lab import Lab, until
from link_states import SOON_MS, WATCHDOG_MS, in_fault, ramping, stopped
from stand import FAULT
from table import Observation


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
