"""The driver on the bench's RTU line in every trouble: a reading is right, or an error; never another register's."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest
import serial

from semlive.data.loading import MotionState
from semlive.errors import LinkError
from semlive.ports import LoadFrame
from semlive_drivers.modbus.load_frame import open_load_frame
from semlive_drivers.modbus.stage import open_stage
from semlive_drivers.modbus.trigger import open_trigger
from semlive_simulators.load_frame.line_faults import Line, LineFault, LineFaultInjector
from semlive_simulators.load_frame.serial_lines import rtu_line
from semlive_simulators.load_frame.server import UNIT
from semlive_simulators.scenario import load_scenario

from ...clocks import MonotonicClock
from ...waiting import wait_until
from ..running_bench import running_bench

CLOCK = MonotonicClock()


@pytest.fixture(scope="module")
def bench() -> Iterator[tuple[str, LineFaultInjector]]:
    with running_bench(load_scenario("paper_x200"), 1.0) as parts, rtu_line(parts.port, UNIT, parts.registers.line_faults) as path:
        yield path, parts.registers.line_faults


def read_until_refused(frame: LoadFrame, times: int) -> int:
    """How many readings were right before one was refused."""
    for place in range(times):
        try:
            sample = frame.read()
        except LinkError:
            return place
        assert abs(sample.force_n) < 30.0
        assert abs(sample.extension_mm) < 0.01
        assert sample.target_n == 0.0
    return times


@pytest.mark.parametrize("trouble", [trouble for trouble in LineFault if trouble is not LineFault.ECHO])
def test_a_reading_in_trouble_is_right_or_refused_and_the_line_comes_back(bench: tuple[str, LineFaultInjector], trouble: LineFault) -> None:
    path, troubles = bench
    settings = {"serial": {"port": path, "slowest_s": 0.5}, "timeout_s": 0.25, "frozen_after_s": 10.0}
    frame = open_load_frame(settings, CLOCK)
    troubles.order(trouble, [Line.RTU], 2, 0.4 if trouble in (LineFault.LATE, LineFault.SILENT) else 0.03)
    read_until_refused(frame, 6)
    frame.close()
    troubles.clear()
    # Late answers queue up at the bench: as the link thread does, it is opened until the line is believed.
    back = []

    def comes_back() -> bool:
        with contextlib.suppress(LinkError):
            again = open_load_frame(settings, CLOCK)
            back.append(read_until_refused(again, 5))
            again.close()
        return back[-1:] == [5]

    wait_until(comes_back)


def test_a_line_with_echo_is_a_setting(bench: tuple[str, LineFaultInjector]) -> None:
    path, troubles = bench
    settings = {"timeout_s": 5.0, "frozen_after_s": 100.0}
    troubles.order(LineFault.ECHO, [Line.RTU], 60, 0.0)
    frame = open_load_frame({**settings, "serial": {"port": path, "slowest_s": 0.3, "echo": True}}, CLOCK)
    assert read_until_refused(frame, 5) == 5
    frame.close()
    troubles.clear()


def test_a_stage_and_a_trigger_over_the_same_kind_of_line(bench: tuple[str, LineFaultInjector]) -> None:
    line = {"serial": {"port": bench[0], "slowest_s": 0.3}, "timeout_s": 5.0}
    stage = open_stage({**line, "kind": "beam", "first_register": 400, "frozen_after_s": 10.0}, CLOCK)
    stage.move_to(3.0, -2.0)
    wait_until(lambda: stage.read().motion is MotionState.STOPPED)
    assert stage.read().x_um == pytest.approx(3.0, abs=1.0)
    with pytest.raises(serial.SerialException, match="xclusively"):
        serial.Serial(bench[0], exclusive=True)  # one line, one owner: what drivers of this process share is closed to others
    stage.close()
    trigger = open_trigger(line, CLOCK)
    trigger.scan_once()
    trigger.close()
