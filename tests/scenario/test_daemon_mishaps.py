"""The machine fails while the specimen is held: the daemon stops it, reports the reason, and applies no further load."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import reduce
from typing import Any

import pytest
from pymodbus.client import ModbusTcpClient

from semlive.service.log.alarms import Alarms, after_message
from semlive.service.log.files import messages

from ..waiting import RUN_END_S, GrowingLog, logged

EMERGENCY_STOP, LIMIT_SWITCH, FRACTURE = 101, 102, 104


def order(bench: dict[str, Any], mishap: int) -> None:
    client = ModbusTcpClient(bench["host"], port=bench["port"], timeout=20, retries=0)
    assert client.connect()
    try:
        assert not client.write_registers(900, [mishap, 0, 0, 500], device_id=bench["unit"]).isError()
    finally:
        client.close()


def free(bench: dict[str, Any]) -> bool:
    """What somebody at the machine does afterwards: acknowledge with a "stop"; whether it obeys again."""
    client = ModbusTcpClient(bench["host"], port=bench["port"], timeout=20, retries=0)
    assert client.connect()
    try:
        client.write_register(4, 2, device_id=bench["unit"])
        return client.read_input_registers(3, count=1, device_id=bench["unit"]).registers[0] == 0
    finally:
        client.close()


@pytest.mark.parametrize(
    ("mishap", "state", "words"),
    [
        (LIMIT_SWITCH, "estopped", "stopped by its limit switch"),
        (EMERGENCY_STOP, "estopped", "stopped by its emergency stop"),
        # The specimen is gone afterwards, so this comes last.
        (FRACTURE, "fault", "did the grips slip, or the specimen break?"),
    ],
)
def test_a_machine_that_fails_in_the_hold_is_stopped_and_loads_nothing_more(
    instrument: Callable[..., Any], wait_until: Callable[..., None], mishap: int, state: str, words: str
) -> None:
    item = instrument(f"mishap-{mishap}")
    item.config["protocol"].update(calibration_shifts_px=[], loads_n=[300.0, 350.0], ramp_rate_n_s=50.0, hold_s=1200.0)
    item.config["limits"].update(force_step_max_n=1000.0, force_rate_max_n_s=60.0, force_drop_max_n=120.0)
    process, growing = item.start(), GrowingLog(item.log)
    wait_until(lambda: "holding" in growing.states())
    order(item.bench, mishap)
    out, err = process.communicate(timeout=RUN_END_S)
    assert process.returncode == 1, out + err
    assert words in " ".join((out + err).split())
    states, commands = logged(item.log, "/state"), logged(item.log, "/command")
    at = next(step for step in states if step["after"] == state)
    assert at["before"] in ("holding", "settling")
    assert all(command["what"] == "stop" for command in commands if command["time_ns"] >= at["time_ns"])
    assert any(command["what"] == "stop" for command in commands)
    alarms = reduce(after_message, messages(item.log), Alarms()).open
    assert any(words in alarm.text and alarm.code for alarm in alarms), alarms
    time.sleep(0.3)
    assert item.load_frame_status() != 1
    wait_until(lambda: free(item.bench))
