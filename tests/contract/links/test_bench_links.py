"""The Modbus drivers and the simulated bench: two programs that were written apart and share only the register map."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from semlive.data.loading import MotionState, StopOnLinkLoss
from semlive.errors import LinkError
from semlive.ports import StopMethods
from semlive.service.runtime.clock import SimulatedClock
from semlive_drivers.modbus.load_frame import open_load_frame
from semlive_drivers.modbus.stage import open_stage
from semlive_drivers.modbus.trigger import open_trigger

from ...waiting import wait_until


@pytest.fixture(scope="module")
def ready(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, object]]:
    out: Path = tmp_path_factory.mktemp("bench")
    arguments = ["--out", str(out), "--rate", "1", "--mode", "triggered", "--exit-with-stdin"]
    process = subprocess.Popen([sys.executable, "-m", "semlive_simulators.bench", *arguments], stdin=subprocess.PIPE)
    try:
        wait_until((out / "ready.json").exists, within_s=60.0)
        yield json.loads((out / "ready.json").read_text(encoding="utf-8"))
    finally:
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(100.0) == 0


def test_the_strain_gage_is_read_with_the_load_where_the_settings_have_one(ready: dict[str, object]) -> None:
    clock = SimulatedClock(Path(str(ready["clock_file"])))
    plain = open_load_frame({"port": ready["port"]}, clock)
    without = plain.read()
    plain.close()
    device = open_load_frame({"port": ready["port"], "strain_gage": True}, clock)
    printed = device.read()
    device.close()
    assert without.gage_strain is None
    assert printed.gage_strain is not None
    assert printed.gage_strain == pytest.approx(1.005 * printed.force_n / 711_000 + 4e-6, abs=20e-6)
    assert len(printed.raw) == len(without.raw) + 2


def test_a_load_frame_without_commands_stops_its_ramp_by_its_watchdog(ready: dict[str, object]) -> None:
    clock = SimulatedClock(Path(str(ready["clock_file"])))
    settings = {"port": ready["port"], "watchdog_s": 2.0}
    device = open_load_frame(settings, clock)
    assert device.identity.simulated
    assert device.identity.stop_on_link_loss is StopOnLinkLoss.ASSUMED
    device.ramp_to(400.0, 10.0)
    sample = device.read()
    assert (sample.motion, sample.target_n) == (MotionState.MOVING, 400.0)
    time.sleep(0.3)
    assert device.read().force_n > sample.force_n - 5.0

    with closing(ModbusTcpClient("127.0.0.1", port=int(str(ready["port"])), timeout=20, retries=0)) as looking:
        assert looking.connect()
        wait_until(lambda: looking.read_input_registers(3, count=1, device_id=int(str(ready["unit"]))).registers == [2])
    again = open_load_frame(settings, clock)
    remaining = again.read()
    assert remaining.motion is MotionState.FAULT
    assert abs(remaining.force_n - remaining.target_n) < 8.0
    again.stop()
    assert again.read().motion is MotionState.STOPPED
    with pytest.raises(LinkError, match=r"the value is not allowed \(exception 3\)"):
        again.ramp_to(5000.0, 10.0)
    again.stop()
    assert again.read().motion is MotionState.STOPPED
    # A device that may be moving gets a stop when its link closes, and keeps its watchdog, which would stop the stage of the next test.
    device.close()
    again.stop()
    again.close()


def test_a_load_frame_that_does_not_obey_its_stop_can_be_stopped_in_other_ways(ready: dict[str, object]) -> None:
    device = open_load_frame({"port": ready["port"], "watchdog_s": 1.0}, SimulatedClock(Path(str(ready["clock_file"]))))
    assert isinstance(device, StopMethods)
    assert device.stop_methods == ("stop of the displacement control", "watchdog withheld")
    for method in range(2):
        device.ramp_to(400.0, 1.0)
        assert device.read().motion is MotionState.MOVING
        device.stop_by(method)
        wait_until(lambda: device.read().motion is not MotionState.MOVING)
    with pytest.raises(LinkError, match="has no stop method 2; it has stop of the displacement control, watchdog withheld"):
        device.stop_by(2)
    device.stop()
    device.close()


def test_a_stage_goes_where_it_is_sent(ready: dict[str, object]) -> None:
    with closing(open_stage({"port": ready["port"], "timeout_s": 5.0}, SimulatedClock(Path(str(ready["clock_file"]))))) as stage:
        stage.move_to(40.0, -5.0)
        assert stage.read().motion is MotionState.MOVING
        wait_until(lambda: stage.read().motion is MotionState.STOPPED)
        sample = stage.read()
    assert (sample.x_um, sample.y_um) == pytest.approx((40.0, -5.0), abs=2.0)


def test_a_second_trigger_finds_the_sem_busy(ready: dict[str, object]) -> None:
    with closing(open_trigger({"port": ready["port"]}, SimulatedClock(Path(str(ready["clock_file"]))))) as trigger:
        trigger.scan_once()
        with pytest.raises(LinkError, match="the device is busy"):
            trigger.scan_once()
