"""What a Modbus device holds after an order, read back and compared."""

from __future__ import annotations

from pathlib import Path

import pytest

from semlive.errors import LinkError
from semlive_drivers.maps import map_text
from semlive_drivers.modbus.load_frame import open_load_frame

from ...clocks import MonotonicClock
from .emulated import Device, over_tcp

CLOCK = MonotonicClock()


def unverified(folder: Path) -> str:
    """The map `generic` without read-backs of its own."""
    path = folder / "unverified.yaml"
    path.write_text(map_text("generic").replace(", verify: true", ""), encoding="utf-8")
    return str(path)


SCALED = {"target": {"dtype": "i16", "scale": 0.1, "address": 10}, "rate": {"dtype": "u16", "scale": 0.1, "address": 12}}


def test_a_value_that_a_device_does_not_take_is_an_error_of_the_order(tmp_path: Path) -> None:
    device = Device(dict.fromkeys(range(20), 0))
    device.after_write = lambda address, values: device.words.update({12: 100})  # its own rate, whatever is ordered
    with over_tcp(device) as port:
        frame = open_load_frame({"map": unverified(tmp_path), "port": port, "registers": SCALED, "confirmed": True}, CLOCK)
        with pytest.raises(LinkError, match=r"did not take the command: its rate \(holding register 12\) holds 10 N/s, 30 N/s was written"):
            frame.ramp_to(300.0, 30.0)
        frame.close()


@pytest.mark.parametrize("exception", [1, 2, 3])
def test_unreadable_registers_are_omitted(tmp_path: Path, exception: int) -> None:
    device = Device(dict.fromkeys(range(20), 0), refuses=lambda pdu: exception if pdu[0] == 3 else 0)
    with over_tcp(device) as port:
        frame = open_load_frame({"map": unverified(tmp_path), "port": port, "confirmed": True}, CLOCK)
        frame.ramp_to(300.0, 30.0)
        assert [frame.read().order_changed for _ in range(3)] == [None] * 3
        assert [pdu[0] for pdu in device.requests].count(3) == 1
        frame.close()


def test_registers_between_the_orders_that_do_not_exist_are_not_read(tmp_path: Path) -> None:
    device = Device(dict.fromkeys((*range(11), 12, 14), 0))
    with over_tcp(device) as port:
        frame = open_load_frame({"map": unverified(tmp_path), "port": port, "registers": SCALED, "confirmed": True}, CLOCK)
        frame.ramp_to(300.0, 30.0)
        assert [frame.read().order_changed for _ in range(3)] == [None] * 3
        device.words[10] = 200
        assert any("target (holding register 10) holds 20 N, 300 N was written" in str(frame.read().order_changed) for _ in range(2))
        frame.close()
