"""A resumed run whose machine is not in the state of its log, or while another daemon is at work on it."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any


def test_a_machine_at_another_position_is_not_moved_without_confirmation(patient: Any, wait_until: Callable[..., None]) -> None:
    patient.start().reach("ramping")
    wait_until(lambda: any(item["force_n"] > 15.0 for item in patient.logged("/load_frame/sample")))
    patient.daemon.send_signal(signal.SIGINT)
    assert patient.end()[0] == 1
    ramps = patient.calls().count("ramp_to")
    # The load frame of the next process begins at 0 N; the log has some 20 N.
    patient.start("--resume", "--yes")
    code, printed = patient.end()
    assert code == 1
    assert "the run was interrupted, and the load is 0.0 N now, and was" in printed
    assert [item["code"] for item in patient.logged("/fault")] == ["moved_at_rest"]
    assert patient.calls().count("ramp_to") == ramps
    assert sorted(path.name for path in patient.log.iterdir()) == ["run.000.mcap", "run.001.mcap"]


def test_a_second_daemon_on_the_same_run_is_refused(patient: Any) -> None:
    first = patient.start().reach("ramping").daemon
    patient.start("--resume", "--yes")
    code, printed = patient.end()
    assert code == 2
    assert "another semlive is at work on this run" in printed
    first.send_signal(signal.SIGKILL)
    first.communicate()
    patient.config["protocol"]["load_tolerance_n"] = 15.0
    patient.start("--resume", "--yes")
    code, printed = patient.end()
    assert code == 2
    assert "protocol.load_tolerance_n is 15.0 in the configuration and 10.0 in the log" in printed
    # The truncated segment was completed at once, and no motion was started.
    assert [path.name for path in patient.log.glob("*.mcap")] == ["run.000.mcap"]
