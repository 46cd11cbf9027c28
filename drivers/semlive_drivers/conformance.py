"""Requirements of every load frame driver, as checks that any test runner can call (docs/reference/drivers.md).

A driver comes with a `DriverFixture`, which opens it and reports what its machine does. Each check takes such a fixture and raises
AssertionError with a message. `CHECKS` holds all checks by name.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Protocol

from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StopOnLinkLoss
from semlive.errors import LinkError
from semlive.ports import BlindStop, LoadFrame, OrderCheck


class DriverFixture(Protocol):
    """A driver and its machine, at rest and unloaded, for one check."""

    reachable_n: float
    """A load that the machine reaches within two seconds; 0 for a driver that moves nothing."""
    tolerance_n: float
    """Largest difference between a target and the reading after the ramp, N."""

    def open(self) -> LoadFrame:
        """Open the driver; called again after `disconnect` and after a close."""
        ...

    def moves(self) -> bool:
        """Whether the machine moves now, independent of the driver."""
        ...

    def disconnect(self) -> None:
        """Interrupt the link: the device does not answer any more. A fixture whose driver has no link does nothing."""
        ...

    def reconnect(self) -> None:
        """Restore the link."""
        ...

    @property
    def can_disconnect(self) -> bool:
        """Whether there is a link to interrupt."""
        ...


Check = Callable[[DriverFixture], None]
_RAMP_TIMEOUT_S = 15.0
_STOP_TIMEOUT_S = 2.0
_RATE_N_S = 100.0


def _until(condition: Callable[[], bool], message: str, within_s: float = _RAMP_TIMEOUT_S) -> None:
    end_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end_s, message
        time.sleep(0.01)


def _refuses(call: Callable[[], object], message: str) -> None:
    error_text = ""
    try:
        call()
    except LinkError as error:
        error_text = str(error)
    assert error_text, message
    assert len(error_text.splitlines()) == 1, "an error must be a single line"


@contextlib.contextmanager
def _opened(fixture: DriverFixture) -> Iterator[LoadFrame]:
    frame = fixture.open()
    try:
        yield frame
    finally:
        with contextlib.suppress(LinkError):
            frame.stop()
        frame.close()


def check_port(fixture: DriverFixture) -> None:
    """The driver has the methods of the port and an identity."""
    with _opened(fixture) as frame:
        assert isinstance(frame, LoadFrame), "the driver lacks a method of semlive.ports.LoadFrame"
        identity = frame.identity
        assert isinstance(identity, DeviceIdentity), "identity must be a DeviceIdentity"
        assert identity.name, "identity must have a name"
        assert isinstance(identity.stop_on_link_loss, StopOnLinkLoss), "identity must state what happens when the link is lost"
        assert identity.force_max_n is None or identity.force_max_n > 0, "a force limit must be positive"


def check_fresh_readings(fixture: DriverFixture) -> None:
    """Readings count from 0 with rising times; a machine at rest reports stopped."""
    with _opened(fixture) as frame:
        samples = [frame.read() for _ in range(4)]
        assert all(isinstance(sample, LoadSample) for sample in samples), "read must return a LoadSample"
        assert [sample.sequence for sample in samples] == [0, 1, 2, 3], "sequence must count readings of this link from 0"
        for before, after in itertools.pairwise(samples):
            assert before.mono_ns <= after.mono_ns, "mono_ns must not fall"
            assert before.time_ns <= after.time_ns, "time_ns must not fall"
        assert all(abs(sample.force_n) < float("inf") for sample in samples), "a force must be a finite number"
        assert samples[-1].motion is MotionState.STOPPED, "a machine at rest must report stopped"


def check_open_is_passive(fixture: DriverFixture) -> None:
    """Opening, reading and closing start no motion."""
    with _opened(fixture) as frame:
        frame.read()
        assert not fixture.moves(), "opening or reading started a motion"
    assert not fixture.moves(), "closing started a motion"


def check_ramp(fixture: DriverFixture) -> None:
    """`ramp_to` brings the load to its target; readings report moving, then stopped, and the target."""
    if not fixture.reachable_n:
        return
    with _opened(fixture) as frame:
        frame.ramp_to(fixture.reachable_n, _RATE_N_S)
        first = frame.read()
        assert first.motion is MotionState.MOVING, "readings must report moving during a ramp"
        assert abs(first.target_n - fixture.reachable_n) < 1e-3 * abs(fixture.reachable_n), "target_n must be the load that was ordered"
        samples = [first]
        _until(lambda: (samples.append(frame.read()), samples[-1].motion is MotionState.STOPPED)[1], "the ramp did not end")
        changed = next((sample.order_changed for sample in samples if sample.order_changed), None)
        assert changed is None, f"no other program commands the machine, but order_changed is: {changed}"
        assert abs(frame.read().force_n - fixture.reachable_n) <= fixture.tolerance_n, "the ramp did not end at its target"
        assert not fixture.moves(), "the driver reports stopped while the machine moves"


def check_stop(fixture: DriverFixture) -> None:
    """`stop` ends a ramp at once, and can be repeated."""
    with _opened(fixture) as frame:
        if fixture.reachable_n:
            frame.ramp_to(fixture.reachable_n, _RATE_N_S)
        frame.stop()
        _until(lambda: not fixture.moves(), "the machine moves after a stop", _STOP_TIMEOUT_S)
        for _ in range(3):
            frame.stop()
            assert frame.read().motion is not MotionState.MOVING, "the driver reports moving after a stop"
        assert not fixture.moves(), "reading after a stop started a motion"


def check_blind_stop(fixture: DriverFixture) -> None:
    """`stop_blind`, if the driver has it, ends a ramp, also after `close`; it returns whether it wrote and raises nothing."""
    with _opened(fixture) as frame:
        if not isinstance(frame, BlindStop):
            return
        if fixture.reachable_n:
            frame.ramp_to(fixture.reachable_n, _RATE_N_S)
            assert frame.stop_blind(), "nothing was written although the machine can be stopped"
            _until(lambda: not fixture.moves(), "the machine moves after a stop that waits for no answer", _STOP_TIMEOUT_S)
        start_s = time.monotonic()
        for _ in range(3):
            frame.stop_blind()
        assert time.monotonic() - start_s < 3.0, "a stop that waits for no answer must not take longer than a few tenths of a second"
        frame.close()
        frame.stop_blind()


def check_blind_stop_on_lost_link(fixture: DriverFixture) -> None:
    """After a failed reading, `stop_blind` can be called repeatedly, also after `close`."""
    if not fixture.can_disconnect:
        return
    frame = fixture.open()
    fixture.disconnect()
    try:
        with contextlib.suppress(LinkError):
            frame.read()
        if isinstance(frame, BlindStop):
            start_s = time.monotonic()
            frame.stop_blind()
            frame.stop_blind()
            frame.close()
            frame.stop_blind()
            assert time.monotonic() - start_s < 3.0, "a stop that waits for no answer must not take longer than a few tenths of a second"
    finally:
        frame.close()
        fixture.reconnect()


def check_order_problem(fixture: DriverFixture) -> None:
    """`order_problem`, if the driver has it, accepts a possible order, names a problem in one line, and moves nothing."""
    with _opened(fixture) as frame:
        if not (isinstance(frame, OrderCheck) and fixture.reachable_n):
            return
        assert frame.order_problem(fixture.reachable_n, _RATE_N_S) is None, "a possible order must not be refused"
        problem = frame.order_problem(float("nan"), _RATE_N_S)
        assert problem is None or len(problem.splitlines()) == 1, "a problem must be a single line"
        assert not fixture.moves(), "checking an order started a motion"


def check_read_only(fixture: DriverFixture) -> None:
    """A driver that only reads refuses a ramp with a LinkError."""
    if fixture.reachable_n:
        return
    with _opened(fixture) as frame:
        _refuses(lambda: frame.ramp_to(10.0, 1.0), "a ramp that no part can perform must raise LinkError")


def check_link_error(fixture: DriverFixture) -> None:
    """Without an answer, a reading raises LinkError within seconds, and so does a stop if a part moves; `close` raises nothing."""
    if not fixture.can_disconnect:
        return
    frame = fixture.open()
    frame.read()
    fixture.disconnect()
    try:
        start_s = time.monotonic()
        _refuses(frame.read, "read raised nothing although the device does not answer")
        if fixture.reachable_n:
            _refuses(frame.stop, "stop raised nothing although the device does not answer")
        assert time.monotonic() - start_s < 8.0, "a lost link must be reported within a few seconds"
        frame.close()
        frame.close()
    finally:
        fixture.reconnect()


def check_reopen(fixture: DriverFixture) -> None:
    """After a lost link, and after an orderly end, the same device answers again, at rest."""
    with _opened(fixture) as frame:
        name = frame.identity.name
        if fixture.can_disconnect:
            fixture.disconnect()
            with contextlib.suppress(LinkError):
                frame.read()
    fixture.reconnect()
    with _opened(fixture) as frame:
        assert frame.identity.name == name, "the same device must have the same name"
        frame.stop()
        assert frame.read().motion is MotionState.STOPPED, "the machine must be at rest after it was opened again and stopped"


CHECKS: Mapping[str, Check] = {
    check.__name__: check
    for check in (
        check_port,
        check_fresh_readings,
        check_open_is_passive,
        check_ramp,
        check_stop,
        check_blind_stop,
        check_blind_stop_on_lost_link,
        check_order_problem,
        check_read_only,
        check_link_error,
        check_reopen,
    )
}
"""All checks by name."""
