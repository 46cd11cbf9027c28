"""After any failure under the daemon: nothing moves any more, the log is complete, one message gives the reason, exit code 1."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

WHOLE = cv2.imencode(".png", np.zeros((8, 8), dtype=np.uint8))[1].tobytes()


def test_a_mistake_in_the_loop_stops_the_machine_and_ends_the_run(patient: Any) -> None:
    patient.start().reach("ramping").falls_ill("load frame raves")
    code, printed = patient.end()
    assert code == 1
    assert "semlive itself failed" in printed
    patient.is_in_order()
    assert patient.logged("/state")[-1]["after"] == "aborted"
    (fault,) = [item for item in patient.logged("/fault") if "semlive itself failed" in item["what"]]
    assert "sequence" in fault["what"]
    assert any("Traceback" in line["text"] for line in patient.logged("/log"))


def test_a_driver_that_never_comes_back_is_noticed(patient: Any) -> None:
    # A stop waits so long for the device's reply, unless a second stop is requested.
    patient.config["limits"]["stop_timeout_s"] = 300.0
    patient.start().reach("ramping").falls_ill("load frame hangs in read")
    patient.reach("stopping").daemon.send_signal(signal.SIGINT)
    patient.daemon.send_signal(signal.SIGTERM)
    code, printed = patient.end()
    assert code == 1
    assert "stop the machine by hand" in printed
    assert "did not confirm" in printed
    assert any(item["after"] == "fault" for item in patient.logged("/state"))


def test_a_driver_that_breaks_while_it_closes_is_opened_again_and_stopped(patient: Any, wait_until: Callable[..., None]) -> None:
    patient.start().reach("ramping").falls_ill("load frame breaks in close")
    patient.falls_ill("load frame is refused read")
    wait_until(lambda: "close" in patient.calls())
    patient.gets_well("load frame is refused read")
    code, printed = patient.end()
    assert code == 1
    assert "the link failed while it may have moved" in printed
    patient.is_in_order()


def test_a_stop_that_is_refused_at_the_end_is_tried_again(patient: Any, wait_until: Callable[..., None]) -> None:
    patient.start().reach("ramping").falls_ill("load frame hangs in stop")
    patient.falls_ill("load frame is refused stop", times=1)
    patient.falls_ill("load frame is refused open", times=2)
    patient.daemon.send_signal(signal.SIGINT)
    patient.daemon.send_signal(signal.SIGTERM)
    wait_until(lambda: any(item["after"] == "aborted" for item in patient.logged("/state")))
    # The stop hangs until the run is over, so whatever is refused is refused at its end.
    time.sleep(0.3)
    patient.gets_well("load frame hangs in stop")
    code, printed = patient.end()
    assert code == 1
    assert "did not confirm" not in printed
    calls = [item for item in patient.calls() if item != "close"]
    # Opening is refused twice, and stops are tried on the failed link meanwhile; what comes last is a stop on a new link.
    assert calls[-2:] == ["open", "stop"]
    assert calls.count("open") >= 4
    assert calls.count("stop") >= 2
    patient.is_in_order()


def test_an_unconfirmed_stop_is_reported(patient: Any) -> None:
    patient.config["limits"]["stop_timeout_s"] = 300.0
    patient.start().reach("ramping").falls_ill("load frame is refused stop")
    patient.daemon.send_signal(signal.SIGINT)
    patient.reach("stopping")  # two signals of one kind that come at once are one
    patient.daemon.send_signal(signal.SIGINT)
    code, printed = patient.end()
    assert code == 1
    assert "load frame did not confirm that it stopped" in printed
    assert any("did not confirm" in item["what"] for item in patient.logged("/fault"))


@pytest.mark.parametrize("ill", ["breaks in", "hangs in"])
def test_a_broken_trigger_ends_the_run(patient: Any, ill: str) -> None:
    patient.config["sem"]["trigger"] = {"driver": "sick", "settings": {**patient.config["load_frame"]["settings"], "name": "sem"}}
    patient.config["protocol"].update(loads_n=[20.0], frame_timeout_s=1.0)
    patient.falls_ill(f"sem {ill} scan_once")
    code, printed = patient.start().end()
    assert code == 1
    assert ("a mistake in scan_once" if ill == "breaks in" else "no frame for step") in printed
    assert patient.calls("sem") == ["open", "scan_once", "close"]
    patient.is_in_order()


def test_a_slow_device_does_not_trip_the_control_timeout_of_the_other_one(patient: Any, wait_until: Callable[..., None]) -> None:
    patient.config["stage"] = {"driver": "sick", "settings": {**patient.config["load_frame"]["settings"], "name": "stage"}}
    patient.falls_ill("stage hangs in open")
    patient.start()
    wait_until(lambda: patient.calls("stage") == ["open"])
    time.sleep(2.5)
    patient.gets_well("stage hangs in open")
    patient.reach("ramping").daemon.send_signal(signal.SIGTERM)
    assert patient.end()[0] == 1
    assert not patient.logged("/fault")


def test_a_hung_analysis_does_not_delay_a_second_stop_request(patient: Any, wait_until: Callable[..., None]) -> None:
    patient.start().reach("ramping")
    os.kill(patient.child(), signal.SIGSTOP)
    patient.falls_ill("load frame hangs in close")
    patient.daemon.send_signal(signal.SIGINT)
    wait_until(lambda: any(item["after"] == "aborted" for item in patient.logged("/state")) and patient.calls()[-1] == "close")
    patient.daemon.send_signal(signal.SIGINT)  # while the links are being closed, before anybody waits for analysis
    patient.gets_well("load frame hangs in close")
    code, printed = patient.end()
    assert code == 1
    assert "semlive replay" in printed
    patient.is_in_order()


def test_an_analysis_that_keeps_dying_is_given_up_and_the_run_ends(patient: Any, wait_until: Callable[..., None]) -> None:
    patient.start().reach("ramping")
    killed: set[int] = set()

    def kill() -> bool:
        try:
            child = patient.child()
        except (ValueError, OSError):
            return patient.daemon.poll() is not None
        if child not in killed:
            os.kill(child, signal.SIGKILL)
            killed.add(child)
        return len(killed) == 4

    wait_until(kill)
    code, printed = patient.end()
    assert code == 1
    assert "given up" in printed
    patient.is_in_order()


def test_a_terminal_that_takes_no_text_does_not_hold_up_the_loop(patient: Any, wait_until: Callable[..., None]) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    filled = 0
    while True:
        try:
            filled += os.write(writing, b"." * 4096)
        except BlockingIOError:
            break
    os.set_blocking(writing, True)
    patient.start(stderr=writing).reach("ramping")
    os.close(writing)
    time.sleep(3.0)
    assert not patient.logged("/fault")
    patient.daemon.send_signal(signal.SIGINT)
    wait_until(lambda: (patient.log / "run.000.mcap").exists())
    patient.is_in_order()
    while os.read(reading, 65536):
        pass
    os.close(reading)
    patient.daemon.communicate(timeout=45.0)
    assert patient.daemon.returncode == 1


def test_a_strange_file_name_does_no_harm_and_a_closed_terminal_stops_the_machine(patient: Any, wait_until: Callable[..., None]) -> None:
    patient.start().reach("ramping")
    folder = os.fsencode(patient.folder / "export")
    for name, data in ((b"strange-\xff.png", b"no picture"), (b"other-\xfe.tif", b""), (b"whole.png", WHOLE)):
        with open(os.path.join(folder, name), "wb") as file:
            file.write(data)
    os.rename(os.path.join(folder, b"strange-\xff.png"), os.path.join(folder, b"gone"))
    # Whoever has taken the one that came last has seen the one before it.
    wait_until(lambda: any(item["name"] == "whole.png" for item in patient.logged("/sem/file")))
    os.unlink(os.path.join(folder, b"other-\xfe.tif"))
    wait_until(lambda: any("other-" in item["name"] for item in patient.logged("/sem/file")))
    patient.daemon.send_signal(signal.SIGHUP)
    assert patient.end()[0] == 1
    patient.is_in_order()
