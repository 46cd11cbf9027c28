"""The drivers without a device: null, and a stage moved by hand."""

from __future__ import annotations

import queue
import time

import pytest

from semlive.data.loading import ControlMode, MotionState, StageKind
from semlive.errors import BadConfig, LinkError
from semlive.ports import LoadFrame, Stage
from semlive_drivers import null
from semlive_drivers.operator import stage as by_hand
from semlive_drivers.operator.console import Console


class Clock:
    def now_ns(self) -> int:
        return 5

    def mono_ns(self) -> int:
        return time.monotonic_ns()


def test_no_load_frame_holds_zero_and_refuses_everything_else() -> None:
    device = null.open_load_frame({}, Clock())
    assert isinstance(device, LoadFrame)
    assert (device.identity.control, device.identity.measures_extension) == (ControlMode.MANUAL, False)
    device.ramp_to(0.0, 1.0)
    with pytest.raises(LinkError, match="there is no load frame to go to 5 N"):
        device.ramp_to(5.0, 1.0)
    device.stop()
    assert [device.read().sequence for _ in range(2)] == [0, 1]
    assert device.read().force_n == 0.0
    device.close()


def test_no_stage_is_where_it_was_sent() -> None:
    device = null.open_stage({}, Clock())
    assert isinstance(device, Stage)
    device.move_to(1.0, 2.0)
    sample = device.read()
    assert (sample.x_um, sample.y_um, sample.motion) == (1.0, 2.0, MotionState.STOPPED)


def test_the_null_driver_has_no_settings() -> None:
    for factory in (null.open_load_frame, null.open_stage):
        with pytest.raises(BadConfig, match="the null driver has no setting 'port'; remove it"):
            factory({"port": 5}, Clock())


@pytest.mark.parametrize(
    ("dx_um", "dy_um", "um_per_px", "words"),
    [
        (10.0, 0.0, 1.25, "move the specimen about 8 px (10.0 um) right in the image, then press enter"),
        (-10.0, 5.0, None, "move the specimen about 10.0 um left and 5.0 um down in the image, then press enter"),
        (0.0, -2.5, 1.25, "move the specimen about 2 px (2.5 um) up in the image, then press enter"),
        (0.0, 0.0, None, "move the specimen about nowhere in the image, then press enter"),
    ],
)
def test_a_manual_move_is_prompted_in_pixels_and_directions(dx_um: float, dy_um: float, um_per_px: float | None, words: str) -> None:
    assert by_hand.move_instruction(dx_um, dy_um, StageKind.SPECIMEN, um_per_px) == words


def test_a_stage_moved_by_hand_moves_until_it_is_confirmed() -> None:
    printed: list[str] = []
    enter: queue.Queue[str] = queue.Queue()
    console = Console(lambda: iter(enter.get, ""), printed.append)
    stage = by_hand.open_stage({"um_per_px": 1.25}, Clock(), console=console)
    assert isinstance(stage, Stage)
    stage.move_to(10.0, 0.0)
    assert printed == ["move the specimen about 8 px (10.0 um) right in the image, then press enter"]
    assert (stage.read().motion, stage.read().x_um) == (MotionState.MOVING, 0.0)
    enter.put("\n")
    end_s = time.monotonic() + 100
    while stage.read().motion is MotionState.MOVING:
        assert time.monotonic() < end_s
    assert stage.read().x_um == 10.0
    stage.move_to(0.0, 0.0)
    stage.stop()
    assert printed[-1] == "do not move the specimen any more"
    assert (stage.read().motion, stage.read().x_um) == (MotionState.STOPPED, 10.0)
    enter.put("")
    stage.close()


def test_settings_of_manual_devices_are_checked() -> None:
    with pytest.raises(BadConfig, match=r"operator stage: um_per_pixel: .*; it has um_per_px, kind"):
        by_hand.open_stage({"um_per_pixel": 1.0}, Clock())
