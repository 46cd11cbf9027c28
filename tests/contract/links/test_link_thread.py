"""The link thread: over a real server, and over a device of a few lines that fails on request."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial

import pytest

from semlive.data.experiment import Limits
from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StopOnLinkLoss
from semlive.engine import (
    CommandAcknowledged,
    Device,
    DeviceFault,
    DeviceStopped,
    Event,
    LinkLost,
    LinkRestored,
    LinkStale,
    LoadReading,
    MoveStage,
    RampTo,
    StageReading,
)
from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.service.device_link import DeviceLink
from semlive_drivers.modbus.load_frame import open_load_frame
from semlive_drivers.modbus.stage import open_stage

from ...clocks import MonotonicClock
from ...waiting import wait_until
from .processes import peer

CLOCK = MonotonicClock()
DEAD_MAN_S = 0.4
LIMITS = Limits(-50.0, 1000.0, -1.0, 1.0, 100.0, 500.0, 100.0, stale_after_s=0.5, lost_after_s=1.5)
IDENTITY = DeviceIdentity("few lines", simulated=True, stop_on_link_loss=StopOnLinkLoss.NONE)


@dataclass
class FewLines:
    """A load frame that records its requests, with their times."""

    calls: list[tuple[str, float]] = field(default_factory=list)
    identity: DeviceIdentity = IDENTITY
    force_n: float = 0.0
    motion: MotionState = MotionState.STOPPED
    trouble: dict[str, Exception] = field(default_factory=dict)
    opened: int = 0
    obeys: bool = False
    answers: threading.Event = field(default_factory=threading.Event)
    """Cleared, a reading hangs after it was noted as `reading`."""

    def __post_init__(self) -> None:
        self.answers.set()

    def note(self, what: str) -> None:
        self.calls.append((what, time.monotonic()))
        if what in self.trouble:
            raise self.trouble[what]

    def open(self) -> FewLines:
        self.opened += 1
        self.note("open")
        return self

    def read(self) -> LoadSample:
        if not self.answers.is_set():
            self.note("reading")
            self.answers.wait(60.0)
        self.note("read")
        return LoadSample(0, CLOCK.now_ns(), CLOCK.mono_ns(), self.force_n, 0.0, self.motion, 0.0)

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        self.note("ramp_to")
        if self.obeys:
            self.motion = MotionState.MOVING

    def stop(self) -> None:
        self.note("stop")
        self.motion = MotionState.STOPPED

    def close(self) -> None:
        self.note("close")

    def times(self, what: str) -> list[float]:
        return [t for name, t in self.calls if name == what]


@dataclass
class Listener:
    """Keeps events."""

    events: list[Event] = field(default_factory=list)

    def __call__(self, event: Event) -> None:
        self.events.append(event)

    def of(self, kind: type) -> list:
        return [e for e in list(self.events) if isinstance(e, kind)]


@contextmanager
def linked(open_device: Callable, listener: Callable[[Event], None], *, fed: bool = True, limits: Limits = LIMITS) -> Iterator[DeviceLink]:
    """An open link, fed from a thread by default, and then often enough on any computer."""
    dead_man_s = 30.0 if fed else DEAD_MAN_S
    link = DeviceLink(Device.LOAD_FRAME, open_device, listener, clock=CLOCK, limits=limits, poll_s=0.02, dead_man_s=dead_man_s)
    over = threading.Event()

    def feeding() -> None:
        while not over.wait(0.05):
            link.keep_alive()

    feeder = threading.Thread(target=feeding)
    link.open()
    if fed:
        feeder.start()
    try:
        yield link
    finally:
        over.set()
        if fed:
            feeder.join()
        link.close()


def test_samples_flow_and_commands_are_taken() -> None:
    listener = Listener()
    with peer() as bench, linked(lambda: open_load_frame({"port": bench.port}, CLOCK), listener) as link:
        assert link.identity.force_max_n == 4300.0
        wait_until(lambda: len(listener.of(LoadReading)) > 5)
        assert link.sample_age_s < 0.5
        link.send(RampTo(100.0, 10.0))
        wait_until(lambda: listener.of(CommandAcknowledged))
        wait_until(lambda: listener.of(LoadReading)[-1].sample.force_n == 100.0)
        before = bench.commands
        link.close()
        assert (bench.commands, bench.last_command) == (before + 1, 2)


def test_a_stage_is_a_link_like_any_other() -> None:
    listener = Listener()
    with peer() as bench:
        link = DeviceLink(Device.STAGE, lambda: open_stage({"port": bench.port}, CLOCK), listener, clock=CLOCK, limits=LIMITS, poll_s=0.02)
        link.open()
        link.send(MoveStage(5.0, 6.0))
        wait_until(lambda: link.keep_alive() or any(e.sample.x_um == 5.0 for e in listener.of(StageReading)))
        link.send(RampTo(5.0, 6.0))
        wait_until(lambda: link.keep_alive() or listener.of(DeviceFault))
        link.close()
    assert "a stage cannot do" in listener.of(DeviceFault)[0].reason


def test_when_control_stops_feeding_the_device_is_stopped_once_and_takes_nothing() -> None:
    device, listener = FewLines(), Listener()
    before_s = time.monotonic()
    with linked(device.open, listener, fed=False) as link:
        opened_s = time.monotonic()
        wait_until(lambda: listener.of(DeviceStopped))
        stop_s = device.times("stop")[0]
        assert stop_s - before_s >= DEAD_MAN_S
        # Not a turn later than it must be: what is read after the time is over belongs to the turn in progress.
        assert sum(opened_s + DEAD_MAN_S < at_s < stop_s for at_s in device.times("read")) <= 1
        printed = re.search(r"control sent no signal for (\d+\.\d) s", listener.of(DeviceStopped)[0].reason)
        assert printed is not None
        assert DEAD_MAN_S - 0.05 <= float(printed[1]) <= stop_s - before_s + 0.05
        link.send(RampTo(10.0, 1.0))
        wait_until(lambda: listener.of(DeviceFault))
        assert device.times("ramp_to") == []
        assert len(device.times("stop")) == 1
        link.keep_alive()
        link.send(RampTo(10.0, 1.0))
        wait_until(lambda: link.keep_alive() or listener.of(CommandAcknowledged))


def test_a_limit_stops_the_device_before_it_is_reported() -> None:
    device, listener = FewLines(motion=MotionState.STOPPED), Listener()
    reported_s: list[float] = []

    def listen(event: Event) -> None:
        listener(event)
        if isinstance(event, LoadReading) and event.sample.force_n > 1000.0:
            reported_s.append(time.monotonic())

    with linked(device.open, listen):
        wait_until(lambda: len(listener.of(LoadReading)) > 2)
        device.force_n = 1001.0
        wait_until(lambda: len(reported_s) > 3)
    violated_s = next(e.sample.mono_ns / 1e9 for e in listener.of(LoadReading) if e.sample.force_n > 1000.0)
    stop_s = device.times("stop")[0]
    assert violated_s <= stop_s <= reported_s[0]
    # At once: nothing is requested of the device in between, and no waiting was done, but the scheduler's.
    assert [what for what, at_s in device.calls if violated_s < at_s < stop_s] == []
    assert listener.of(DeviceStopped)[0].reason == "the load is 1001.0 N, outside the limits -50 to 1000 N"
    assert len(listener.of(DeviceStopped)) == 1


def test_a_sudden_fall_of_the_load_stops_the_device_before_it_is_reported() -> None:
    device, listener = FewLines(force_n=500.0), Listener()
    with linked(device.open, listener, limits=replace(LIMITS, force_drop_max_n=50.0)) as link:
        link.send(RampTo(600.0, 10.0))
        wait_until(lambda: len(listener.of(LoadReading)) > 5)
        device.force_n = 420.0
        wait_until(lambda: bool(listener.of(DeviceStopped)))
    fell_s = next(e.sample.mono_ns / 1e9 for e in listener.of(LoadReading) if e.sample.force_n == 420.0)
    assert next(what for what, at_s in device.calls if fell_s < at_s) == "stop"
    assert "the load fell by 80 N to 420 N" in listener.of(DeviceStopped)[0].reason


def test_a_limit_stops_a_real_link() -> None:
    listener = Listener()
    with peer() as bench:
        bench.set_force(395.0)  # this server is at the target at once; a reading of 400 N after one of 0 N is a jump, and stops the ramp
        with linked(lambda: open_load_frame({"port": bench.port}, CLOCK), listener) as link:
            link.send(RampTo(400.0, 10.0))
            wait_until(lambda: listener.of(CommandAcknowledged))
            bench.set_force(1200.0)
            wait_until(lambda: listener.of(DeviceStopped))
            assert bench.last_command == 2


def test_a_stop_goes_before_everything_that_waits() -> None:
    device, listener = FewLines(), Listener()
    with linked(device.open, listener) as link:
        device.answers.clear()
        wait_until(lambda: device.times("reading"))
        for _ in range(3):
            link.send(RampTo(10.0, 1.0))
        link.stop("enough")
        began = len(device.calls)
        device.answers.set()
        wait_until(lambda: len(device.calls) > began + 5)
        # One answer is waited for, that of the reading under way.
        assert [what for what, _ in device.calls[began : began + 2]] == ["read", "stop"]
        assert device.times("ramp_to") == []


def test_a_hung_device_gets_stale_then_lost_and_is_stopped_first_when_it_is_back() -> None:
    listener = Listener()
    with peer() as bench, linked(lambda: open_load_frame({"port": bench.port}, CLOCK), listener) as link:
        wait_until(lambda: listener.of(LoadReading))
        before = bench.commands
        bench.pause()
        paused_s = time.monotonic()
        wait_until(lambda: listener.of(LinkLost))
        assert listener.of(LinkStale)[0].time_ns / 1e9 - paused_s < 1.2
        assert listener.of(LinkLost)[0].time_ns / 1e9 - paused_s < 2.5
        assert "gave no answer within 0.3 s" in listener.of(LinkLost)[0].reason
        assert link.sample_age_s > 1.5
        bench.go_on()
        wait_until(lambda: listener.of(LinkRestored))
        assert (bench.commands, bench.last_command) == (before + 1, 2)
        count = len(listener.of(LoadReading))
        wait_until(lambda: len(listener.of(LoadReading)) > count)
    assert len(listener.of(LinkStale)) == len(listener.of(LinkLost)) == len(listener.of(LinkRestored)) == 1


def test_a_server_that_dies_in_a_ramp_and_comes_back_is_stopped_and_never_moved() -> None:
    listener = Listener()
    with peer() as bench, linked(lambda: open_load_frame({"port": bench.port}, CLOCK), listener) as link:
        link.send(RampTo(100.0, 10.0))
        wait_until(lambda: listener.of(CommandAcknowledged))
        bench.kill()
        wait_until(lambda: listener.of(DeviceStopped))
        assert "the link failed while it may have moved" in listener.of(DeviceStopped)[0].reason
        with peer(port=bench.port) as again:
            count = len(listener.of(LoadReading))
            wait_until(lambda: len(listener.of(LoadReading)) > count + 5)
            # The stop is written by itself and again by the new link; nothing else is ordered.
            assert 1 <= again.commands <= 4
            assert again.last_command == 2


def test_a_short_hiccup_at_rest_changes_nothing() -> None:
    device, listener = FewLines(), Listener()
    with linked(device.open, listener, limits=replace(LIMITS, stale_after_s=30.0, lost_after_s=60.0)):
        wait_until(lambda: len(listener.of(LoadReading)) > 2)
        device.trouble["read"] = LinkError("no answer")
        wait_until(lambda: device.opened > 1)
        device.trouble.clear()
        count = len(listener.of(LoadReading))
        wait_until(lambda: len(listener.of(LoadReading)) > count + 2)
        assert device.times("stop") == []
    assert {type(e) for e in listener.events} == {LoadReading}


def test_a_failure_on_the_way_stops_at_the_first_chance() -> None:
    device, listener = FewLines(obeys=True), Listener()
    with linked(device.open, listener) as link:
        link.send(RampTo(10.0, 1.0))
        wait_until(lambda: listener.of(CommandAcknowledged))
        device.trouble["read"] = LinkError("no answer")
        wait_until(lambda: len(device.times("stop")) > 1)
        names = [name for name, _ in device.calls]
        assert names[names.index("close") :][:3] == ["close", "open", "stop"]
        # A device that cannot be read may still take orders: the link that failed got the stop first.
        assert names[names.index("close") - 1] == "stop"
        assert "no answer" in listener.of(DeviceStopped)[0].reason


def test_a_command_that_is_refused_is_a_fault_and_a_stop() -> None:
    device, listener = FewLines(trouble={"ramp_to": LinkError("the device is busy")}), Listener()
    with linked(device.open, listener) as link:
        link.send(RampTo(10.0, 1.0))
        wait_until(lambda: device.times("stop"))
    assert [e.reason for e in listener.of(DeviceFault)] == ["the device is busy"]
    assert listener.of(CommandAcknowledged) == []


def test_a_mistake_in_a_driver_does_not_end_the_thread() -> None:
    device, listener = FewLines(trouble={"read": ZeroDivisionError("oops")}), Listener()
    with linked(device.open, listener):
        wait_until(lambda: device.opened > 2)
        device.trouble.clear()
        wait_until(lambda: listener.of(LoadReading))


def test_a_stop_that_fails_is_tried_again_until_it_is_taken() -> None:
    device, listener = FewLines(trouble={"stop": LinkError("no answer")}), Listener()
    with linked(device.open, listener) as link:
        link.stop("enough")
        wait_until(lambda: len(device.times("stop")) > 2)
        device.trouble.clear()
        count = len(device.times("stop"))
        wait_until(lambda: len(device.times("stop")) > count)
        wait_until(lambda: listener.of(LoadReading))


def test_when_nobody_listens_the_device_is_stopped() -> None:
    device = FewLines()

    def failing_callback(event: Event) -> None:
        raise RuntimeError("Event loop is closed")

    with linked(device.open, failing_callback):
        wait_until(lambda: device.times("stop"))


def test_another_device_at_the_same_place_is_not_accepted() -> None:
    device, listener = FewLines(), Listener()
    with linked(device.open, listener):
        wait_until(lambda: listener.of(LoadReading))
        device.identity = replace(IDENTITY, name="somebody else")
        device.trouble["read"] = LinkError("no answer")
        wait_until(lambda: device.opened > 1)
        device.trouble.clear()
        wait_until(lambda: listener.of(LinkLost))
    assert listener.of(LinkLost)[0].reason == "another device answers: somebody else instead of few lines; check what is connected"


def test_a_device_that_moves_when_the_link_opens_is_stopped() -> None:
    device, listener = FewLines(motion=MotionState.MOVING), Listener()
    with linked(device.open, listener):
        wait_until(lambda: listener.of(DeviceStopped))
    assert listener.of(DeviceStopped)[0].reason == "it moved before a motion was ordered"


@pytest.mark.parametrize("error", [LinkRefused("nobody answers"), BadConfig("no such key")])
def test_an_error_at_opening_is_raised_to_the_opener(error: Exception) -> None:
    device = FewLines(trouble={"open": error})
    link = DeviceLink(Device.LOAD_FRAME, device.open, Listener(), clock=CLOCK, limits=LIMITS)
    with pytest.raises(type(error), match=str(error)):
        link.open()
    link.close()


def test_closing_stops_a_device_whose_link_was_down() -> None:
    device, listener = FewLines(obeys=True), Listener()
    with linked(device.open, listener) as link:
        link.send(RampTo(10.0, 1.0))
        wait_until(lambda: listener.of(CommandAcknowledged))
        device.trouble = {"read": LinkError("no answer"), "open": LinkError("no answer")}
        wait_until(lambda: device.opened > 2)
        device.trouble.clear()
        mended = time.monotonic()
    assert device.times("stop")[-1] > mended
    # Then it is read until it is seen to rest.
    assert device.times("read")[-1] > device.times("stop")[-1]
    assert device.calls[-1][0] == "close"


def test_a_link_reports_what_its_stage_moves() -> None:
    for kind in ("specimen", "beam"):
        listener = Listener()
        with peer() as bench:
            opened = partial(open_stage, {"port": bench.port, "kind": kind}, CLOCK)
            stage = DeviceLink(Device.STAGE, opened, listener, clock=CLOCK, limits=LIMITS)
            assert stage.stage_kind is None
            stage.open()
            assert stage.stage_kind == kind
            stage.close()
