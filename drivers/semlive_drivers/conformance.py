"""What every load frame's driver must do, as checks that any test runner can call (docs/reference/drivers.md).

A driver comes with a `DriverFixture`: how to open it, and what the machine behind it really does. Each check takes a rig and raises
AssertionError with a sentence. `CHECKS` is all of them, by name.
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
    """A driver with a machine behind it, at rest and unloaded, for one check."""

    reachable_n: float
    """A load that the machine reaches within a second or two; 0 for a driver that moves nothing."""
    tolerance_n: float
    """How near to a target its readings come."""

    def open(self) -> LoadFrame:
        """Open the driver anew; called again after `disconnect` and after a close."""
        ...

    def moves(self) -> bool:
        """Whether the machine really moves now."""
        ...

    def disconnect(self) -> None:
        """Break the link: from now on nobody answers. A rig whose driver has no link does nothing."""
        ...

    def reconnect(self) -> None:
        """Take that back."""
        ...

    @property
    def can_disconnect(self) -> bool:
        """Whether there is a link to cut."""
        ...


Check = Callable[[DriverFixture], None]
_PATIENCE_S = 15.0
_A_STOP_S = 2.0
_RATE_N_S = 100.0


def _until(true: Callable[[], bool], sentence: str, within_s: float = _PATIENCE_S) -> None:
    end_s = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < end_s, sentence
        time.sleep(0.01)


def _refuses(call: Callable[[], object], sentence: str) -> None:
    said = ""
    try:
        call()
    except LinkError as error:
        said = str(error)
    assert said, sentence
    assert len(said.splitlines()) == 1, "an error is one sentence"


@contextlib.contextmanager
def _opened(rig: DriverFixture) -> Iterator[LoadFrame]:
    frame = rig.open()
    try:
        yield frame
    finally:
        with contextlib.suppress(LinkError):
            frame.stop()
        frame.close()


def check_port(rig: DriverFixture) -> None:
    """It has the methods of the port and tells who it is."""
    with _opened(rig) as frame:
        assert isinstance(frame, LoadFrame), "it lacks a method of semlive.ports.LoadFrame"
        identity = frame.identity
        assert isinstance(identity, DeviceIdentity), "identity must be a DeviceIdentity"
        assert identity.name, "identity must have a name"
        assert isinstance(identity.stop_on_link_loss, StopOnLinkLoss), "identity must say what happens when the link is lost"
        assert identity.force_max_n is None or identity.force_max_n > 0, "a force limit must be positive"


def check_fresh_readings(rig: DriverFixture) -> None:
    """Readings count from 0 and carry rising times; a machine at rest says so."""
    with _opened(rig) as frame:
        samples = [frame.read() for _ in range(4)]
        assert all(isinstance(sample, LoadSample) for sample in samples), "read must give a LoadSample"
        assert [sample.sequence for sample in samples] == [0, 1, 2, 3], "sequence must count readings of this link from 0"
        for before, after in itertools.pairwise(samples):
            assert before.mono_ns <= after.mono_ns, "mono_ns must not fall"
            assert before.time_ns <= after.time_ns, "time_ns must not fall"
        assert all(abs(sample.force_n) < float("inf") for sample in samples), "a force must be a finite number"
        assert samples[-1].motion is MotionState.STOPPED, "a machine at rest must say stopped"


def check_open_is_passive(rig: DriverFixture) -> None:
    """Opening, reading and closing leave the machine at rest."""
    with _opened(rig) as frame:
        frame.read()
        assert not rig.moves(), "opening or reading began a motion"
    assert not rig.moves(), "closing began a motion"


def check_ramp(rig: DriverFixture) -> None:
    """`ramp_to` brings the load to its target; readings say moving, then stopped; the target is told."""
    if not rig.reachable_n:
        return
    with _opened(rig) as frame:
        frame.ramp_to(rig.reachable_n, _RATE_N_S)
        first = frame.read()
        assert first.motion is MotionState.MOVING, "a ramp under way must say moving"
        assert abs(first.target_n - rig.reachable_n) < 1e-3 * abs(rig.reachable_n), "target_n must be the load that was asked for"
        seen = [first]
        _until(lambda: (seen.append(frame.read()), seen[-1].motion is MotionState.STOPPED)[1], "the ramp did not end")
        changed = next((sample.order_changed for sample in seen if sample.order_changed), None)
        assert changed is None, f"nobody else commands it, and it says: {changed}"
        assert abs(frame.read().force_n - rig.reachable_n) <= rig.tolerance_n, "the ramp ended away from its target"
        assert not rig.moves(), "it says stopped and moves"


def check_stop(rig: DriverFixture) -> None:
    """`stop` ends a ramp at once, and any number of stops do no harm."""
    with _opened(rig) as frame:
        if rig.reachable_n:
            frame.ramp_to(rig.reachable_n, _RATE_N_S)
        frame.stop()
        _until(lambda: not rig.moves(), "the machine moves after a stop", _A_STOP_S)
        for _ in range(3):
            frame.stop()
            assert frame.read().motion is not MotionState.MOVING, "it says moving after a stop"
        assert not rig.moves(), "reading after a stop began a motion"


def a_stop_without_an_answer_stops(rig: DriverFixture) -> None:
    """`stop_blind`, where the driver has it, ends a ramp, also after `close`; it says whether it wrote and raises nothing."""
    with _opened(rig) as frame:
        if not isinstance(frame, BlindStop):
            return
        if rig.reachable_n:
            frame.ramp_to(rig.reachable_n, _RATE_N_S)
            assert frame.stop_blind(), "nothing was written although the machine can be stopped"
            _until(lambda: not rig.moves(), "the machine moves after a stop that waits for no answer", _A_STOP_S)
        began_s = time.monotonic()
        for _ in range(3):
            frame.stop_blind()
        assert time.monotonic() - began_s < 3.0, "a stop that waits for no answer must not take longer than a few tenths of a second"
        frame.close()
        frame.stop_blind()


def a_stop_without_an_answer_raises_nothing_on_a_cut_link(rig: DriverFixture) -> None:
    """After a failed reading, `stop_blind` can be called again and again, also after `close`."""
    if not rig.can_disconnect:
        return
    frame = rig.open()
    rig.disconnect()
    try:
        with contextlib.suppress(LinkError):
            frame.read()
        if isinstance(frame, BlindStop):
            began_s = time.monotonic()
            frame.stop_blind()
            frame.stop_blind()
            frame.close()
            frame.stop_blind()
            assert time.monotonic() - began_s < 3.0, "a stop that waits for no answer must not take longer than a few tenths of a second"
    finally:
        frame.close()
        rig.reconnect()


def an_order_is_checked_without_moving(rig: DriverFixture) -> None:
    """`order_problem`, where the driver has it, accepts an order that is carried out, names what cannot be ordered, and moves nothing."""
    with _opened(rig) as frame:
        if not (isinstance(frame, OrderCheck) and rig.reachable_n):
            return
        assert frame.order_problem(rig.reachable_n, _RATE_N_S) is None, "an order that can be carried out must not be refused"
        found = frame.order_problem(float("nan"), _RATE_N_S)
        assert found is None or len(found.splitlines()) == 1, "a problem is one sentence"
        assert not rig.moves(), "checking an order began a motion"


def check_read_only(rig: DriverFixture) -> None:
    """A driver that only reads refuses a ramp with a LinkError."""
    if rig.reachable_n:
        return
    with _opened(rig) as frame:
        _refuses(lambda: frame.ramp_to(10.0, 1.0), "a ramp that nobody can do must raise LinkError")


def check_link_error(rig: DriverFixture) -> None:
    """Without an answer a reading raises LinkError in one sentence, soon; so does a stop where anything moves; `close` raises nothing."""
    if not rig.can_disconnect:
        return
    frame = rig.open()
    frame.read()
    rig.disconnect()
    try:
        began_s = time.monotonic()
        _refuses(frame.read, "read raised nothing although nobody answers")
        if rig.reachable_n:
            _refuses(frame.stop, "stop raised nothing although nobody answers")
        assert time.monotonic() - began_s < 8.0, "a lost link must be told within a few seconds"
        frame.close()
        frame.close()
    finally:
        rig.reconnect()


def check_reopen(rig: DriverFixture) -> None:
    """After a cut link, and after an orderly end, the same device answers again, at rest."""
    with _opened(rig) as frame:
        name = frame.identity.name
        if rig.can_disconnect:
            rig.disconnect()
            with contextlib.suppress(LinkError):
                frame.read()
    rig.reconnect()
    with _opened(rig) as frame:
        assert frame.identity.name == name, "the same device must have the same name"
        frame.stop()
        assert frame.read().motion is MotionState.STOPPED, "it must be at rest after it was opened again and stopped"


CHECKS: Mapping[str, Check] = {
    check.__name__: check
    for check in (
        check_port,
        check_fresh_readings,
        check_open_is_passive,
        check_ramp,
        check_stop,
        a_stop_without_an_answer_stops,
        a_stop_without_an_answer_raises_nothing_on_a_cut_link,
        an_order_is_checked_without_moving,
        check_read_only,
        check_link_error,
        check_reopen,
    )
}
"""All checks by name."""
