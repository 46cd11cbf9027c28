"""One thread for each device link. It alone touches the device, and it stops the device on its own when in doubt.

Order of precedence in every turn: the dead-man, a stop that is owed, commands, the next reading. A device call blocks for at most
the driver's timeout, so a stop waits for at most one answer. The thread never begins a motion by itself.

After a stop the device is pursued until its readings show that it rests (`stop_pursuit`). When a request fails while the device may
move, the stop is first written without waiting for an answer, on the old connection and on a fresh one, again and again until a link is
open; only then is anything read: a device may execute what it cannot answer.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceIdentity, LoadSample, MotionState, StageKind, StageSample
from semlive.engine.events import (
    CommandAcknowledged,
    Device,
    DeviceFault,
    DeviceStopped,
    Event,
    LinkLost,
    LinkRestored,
    LinkStale,
)
from semlive.engine.resume import RampOrder
from semlive.engine.supervision.ramp_readings import Finding
from semlive.errors import LinkError, LinkRefused
from semlive.ports import BlindStop, ClockSource, LoadFrame, OrderCheck, OrderRecall, Stage
from semlive.service.control.link_ports import Order, Port, port_of
from semlive.service.control.stop_pursuit import StopPursuit, begin_pursuit
from semlive.service.runtime.pause import pause

_BACKOFF_S = (0.0, 0.1, 0.2, 0.5, 1.0)
_LONGEST_SLEEP_S = 0.05
# How long closing pursues a device that does not rest, at most and without any reading, and how often it looks meanwhile. A reading over a
# slow gateway takes a second, and three of them show rest.
_LAST_PURSUIT_S = 10.0
_LAST_SILENCE_S = 4.0
_LAST_LOOK_S = 0.05


class DeviceLink:
    """Owns one device from opening to closing.

    Args:
        device: what it is, for events.
        open_device: opens the link anew each time it is called; called in the thread only.
        on_event: takes engine events, in the thread; must not block. If it raises, the device is stopped.
        clock: experiment time and the monotonic clock.
        limits: checked on every sample here, besides in the engine; also says when a sample is stale or the link lost.
        poll_s: wall time from one reading to the next.
        dead_man_s: `keep_alive` must be called at least this often (wall time), else the device is stopped.
        recalled: the ramp that an earlier process of a resumed run ordered last; the load frame compares it with what its device holds.
    """

    def __init__(
        self,
        device: Device,
        open_device: Callable[[], LoadFrame] | Callable[[], Stage],
        on_event: Callable[[Event], None],
        *,
        clock: ClockSource,
        limits: Limits,
        poll_s: float = 0.05,
        dead_man_s: float = 2.0,
        recalled: RampOrder | None = None,
    ) -> None:
        self._device, self._open_device, self._on_event = device, open_device, on_event
        self._clock, self._limits, self._recalled = clock, limits, recalled
        self._poll_ns, self._dead_man_ns = round(poll_s * 1e9), round(dead_man_s * 1e9)

        # Shared with control, guarded by the condition.
        self._wake = threading.Condition()
        self._orders: deque[Order] = deque()
        self._stop_asked = False
        self._closing = False
        self._fed_mono_ns = clock.mono_ns()
        self._sampled_mono_ns: int | None = None
        self._turned_mono_ns = clock.mono_ns()

        # The thread's own.
        self._thread = threading.Thread(target=self._run, name=f"link to {device.words}", daemon=True)
        self._answered = threading.Event()
        self._open_error: Exception | None = None
        self._identity: DeviceIdentity | None = None
        self._moves: StageKind | None = None
        self._link: LoadFrame | Stage | None = None
        self._port: Port | None = None
        self._failed_link: LoadFrame | Stage | None = None
        self._pursuit: StopPursuit | None = None
        self._stop_owed = False
        self._may_move = False
        self._beyond_limit = False
        self._unfed = False
        self._stale = False
        self._lost = False
        self._trouble = ""
        self._failures = 0
        self._next_open_mono_ns = self._last_read_mono_ns = 0
        self._next_poll_mono_ns = 0
        self._rests = self._mistaken = False
        self._counted: int | None = None

    # ------------------------------------------------------------------ for control

    def open(self, timeout_s: float = 10.0) -> DeviceIdentity:
        """Start the thread and wait until the device has answered.

        Raises:
            LinkRefused: if nobody answers in time.
            LinkError: if something wrong answers.
            BadConfig: if the driver does not understand its settings.
        """
        self.keep_alive()
        self._thread.start()
        if not self._answered.wait(timeout_s):
            self.close(0.0)
            raise LinkRefused(f"the {self._device.words} did not answer within {timeout_s:g} s; check that it is on and connected")
        if self._open_error is not None:
            raise self._open_error
        self.keep_alive()
        return self.identity

    @property
    def identity(self) -> DeviceIdentity:
        """Who answered when the link was opened first."""
        if self._identity is None:
            raise RuntimeError("the link is not open")
        return self._identity

    @property
    def stage_kind(self) -> StageKind | None:
        """What a stage moves, the specimen or the beam; None for a load frame, and before the link was opened first."""
        return self._moves

    def order_problem(self, ramps: Iterable[tuple[float, float]]) -> str | None:
        """Why one of some ramps, (target in N, rate in N/s), cannot be ordered as meant, or None; for a link just opened, sends nothing."""
        link = self._link
        if not isinstance(link, OrderCheck):
            return None
        return next((problem for ramp in ramps if (problem := link.order_problem(*ramp))), None)

    @property
    def sample_age_s(self) -> float:
        """Wall time since the last sample; infinite before the first."""
        sampled = self._sampled_mono_ns
        return math.inf if sampled is None else (self._clock.mono_ns() - sampled) / 1e9

    @property
    def blocked_s(self) -> float:
        """Wall time since the thread went into its driver or began a turn: a driver that never comes back keeps it away."""
        return (self._clock.mono_ns() - self._turned_mono_ns) / 1e9 if self._thread.is_alive() and self._answered.is_set() else 0.0

    def keep_alive(self) -> None:
        """Control is alive."""
        with self._wake:
            self._fed_mono_ns = self._clock.mono_ns()

    def send(self, command: Order) -> None:
        """Give a motion command; returns at once. CommandTaken or DeviceFault follows, unless a stop comes first."""
        with self._wake:
            self._orders.append(command)
            self._wake.notify_all()

    def stop(self, reason: str) -> None:
        """Stop motion ahead of everything else and forget waiting commands; returns at once."""
        del reason  # the caller records it
        with self._wake:
            self._orders.clear()
            self._stop_asked = True
            self._wake.notify_all()

    def close(self, timeout_s: float = 12.0) -> bool:
        """Stop motion, close the link, end the thread; never raises, any number of times.

        Returns:
            True if the device was seen to rest after the last stop, or never was ours to move; False if nobody knows whether it rests.
        """
        with self._wake:
            self._orders.clear()
            # Who did not come back in time is not waited for a second time.
            timeout_s, self._closing = 0.0 if self._closing else timeout_s, True
            self._wake.notify_all()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout_s)
        return self._identity is None or (self._rests and not self._thread.is_alive())

    # ------------------------------------------------------------------ the thread

    def _run(self) -> None:
        try:
            self._open()
        except Exception as error:
            # Whatever a driver raises while opening belongs to the caller of open().
            self._open_error = error
            self._answered.set()
            return
        self._turned_mono_ns = self._clock.mono_ns()
        self._answered.set()
        while not self._closing:
            self._guarded(self._turn)
            self._sleep()
        self._guarded(self._shut)

    def _guarded(self, call: Callable[[], None]) -> None:
        """Nothing may end the one thread that can stop the device: after a mistake of ours it stops it, and goes on."""
        try:
            call()
            self._mistaken = False
        except Exception as error:
            self._stop_owed = True
            mistaken, self._mistaken = self._mistaken, True
            reason = f"its link thread made a mistake: {error!r}"
            with contextlib.suppress(Exception):
                event = DeviceFault(self._clock.now_ns(), self._device, reason, code=FaultCode.INTERNAL_ERROR)
                None if mistaken else self._emit(event)
            pause(_LONGEST_SLEEP_S)

    def _turn(self) -> None:
        now = self._turned_mono_ns = self._clock.mono_ns()
        self._check_dead_man(now)
        with self._wake:
            self._stop_owed, self._stop_asked = self._stop_owed or self._stop_asked, False
        if self._link is None:
            self._reopen(now)
        if self._stop_owed:
            self._stop_device()
        elif self._pursuit is not None:
            self._pursue(self._pursuit)
        elif self._link is not None:
            self._obey_next()
        if self._link is not None and not self._stop_asked and self._clock.mono_ns() >= self._next_poll_mono_ns:
            self._next_poll_mono_ns = self._clock.mono_ns() + self._poll_ns
            self._attempt("reading", self._poll)
        self._check_age()

    def _reopen(self, now_mono_ns: int) -> None:
        """A stop that is owed is written before anything is read from the device."""
        if self._stop_owed:
            self._stop_device()
        if now_mono_ns >= self._next_open_mono_ns:
            self._attempt("opening the link again", self._open)

    def _sleep(self) -> None:
        """Until the next reading is due, or control wants something."""
        with self._wake:
            if self._stop_asked or self._closing or (self._orders and self._link is not None and self._pursuit is None):
                return
            until_s = (self._next_poll_mono_ns - self._clock.mono_ns()) / 1e9 if self._link is not None else _LONGEST_SLEEP_S
            if until_s > 0:
                self._wake.wait(min(until_s, _LONGEST_SLEEP_S))

    def _attempt(self, doing: str, call: Callable[[], None]) -> bool:
        """Call the device; whatever goes wrong ends this link, and the next turn opens another."""
        self._turned_mono_ns = self._clock.mono_ns()
        try:
            call()
        except Exception as error:
            # A driver's bug must not end the one thread that can stop the device.
            self._fail(str(error) if isinstance(error, LinkError) else f"{doing} failed in the driver: {error!r}")
            return False
        return True

    def _open(self) -> None:
        link = self._open_device()
        try:
            identity = link.identity
            if self._identity is not None and identity.name != self._identity.name:
                raise LinkError(f"another device answers: {identity.name} instead of {self._identity.name}; check what is connected")
        except Exception:
            with contextlib.suppress(Exception):
                link.close()
            raise
        self._port = port_of(link, self._limits)
        if self._identity is None and self._recalled is not None and isinstance(link, OrderRecall):
            link.recall_order(self._recalled.force_n, self._recalled.rate_n_s)
        self._link, self._identity, self._failed_link = link, identity, None
        self._moves = None if isinstance(link, LoadFrame) else link.kind
        if self._may_move:
            self._stop_owed = True

    def _poll(self) -> None:
        port = self._port
        if port is None:
            return
        first = self._sampled_mono_ns is None
        asked_ns = time.monotonic_ns()
        sample = port.read()
        sample = replace(sample, rtt_s=(time.monotonic_ns() - asked_ns) / 1e9)
        problem = port.problem(sample)
        stopped_for: Finding | None = None
        if problem is not None and not self._beyond_limit:
            stopped_for = problem
        elif first and sample.motion is MotionState.MOVING:
            stopped_for = Finding(FaultCode.UNORDERED_MOTION, "it moved before a motion was ordered")
        self._beyond_limit = problem is not None
        if stopped_for is not None:
            self._stop_device()
        elif self._pursuit is not None:
            self._pursuit = self._pursuit.with_sample(sample)
        self._failures = 0
        self._sampled_mono_ns = sample.mono_ns
        self._may_move = sample.motion is MotionState.MOVING or self._pursuit is not None
        if self._lost:
            self._emit(LinkRestored(sample.time_ns, self._device))
        self._stale = self._lost = False
        self._emit(port.event(sample))
        if stopped_for is not None:
            self._emit_stop(sample, stopped_for)
        self._check_restart(sample)

    def _emit_stop(self, sample: LoadSample | StageSample, finding: Finding) -> None:
        """Limits are judged by the engine, too, from the reading itself; everything else only this thread has seen."""
        own = finding.code in (FaultCode.LIMIT, FaultCode.UNORDERED_MOTION)
        event = DeviceStopped if own else DeviceFault
        self._emit(event(sample.time_ns, self._device, finding.reason, code=finding.code))

    def _check_restart(self, sample: LoadSample | StageSample) -> None:
        """A device that was switched off and on has forgotten its orders, and perhaps where it is; the link alone does not show it."""
        if not isinstance(sample, LoadSample) or sample.counted is None:
            return
        count, begins_anew = sample.counted
        before, self._counted = self._counted, count
        if before is not None and (count - before) % begins_anew > begins_anew // 2:
            what = f"it was restarted: its counter of readings went from {before} to {count}; check its zero, position and settings"
            self._emit(DeviceFault(sample.time_ns, self._device, what, code=FaultCode.DEVICE_RESTARTED))

    def _obey_next(self) -> None:
        with self._wake:
            order = self._orders.popleft() if self._orders else None
        if order is None or self._port is None:
            return
        if self._unfed:
            self._emit(
                DeviceFault(
                    self._clock.now_ns(), self._device, "a command came while control was not feeding the link", code=FaultCode.CONTROL_LOST
                )
            )
            return
        self._may_move, self._beyond_limit = True, False
        self._turned_mono_ns = self._clock.mono_ns()
        try:
            self._port.obey(order)
        except Exception as error:
            self._stop_owed = True
            self._emit(DeviceFault(self._clock.now_ns(), self._device, str(error), code=FaultCode.ORDER_REFUSED))
            return
        self._emit(CommandAcknowledged(self._clock.now_ns(), self._device))

    def _stop_device(self) -> None:
        """Stop, and pursue until it rests; a stop that fails stays owed, and comes first when the link is open again."""
        self._stop_owed = True
        now = self._clock.mono_ns()
        pursuit = self._pursuit or begin_pursuit(now)
        port = self._port
        if port is None:
            self._stop_blind(pursuit)
            return
        self._pursuit = pursuit.sent_again(now)
        if self._attempt("stopping", port.stop):
            self._stop_owed = False

    def _pursue(self, pursuit: StopPursuit) -> None:
        """Send the stop again while the device moves; the pursuit ends when it rests."""
        now, still = self._clock.mono_ns(), None if self._port is None else self._port.still()
        if pursuit.rests(still):
            self._pursuit = None
            return
        if pursuit.moves(still):
            self._alarm(pursuit, moves=True)
        if pursuit.due(now, still):
            self._stop_device()

    def _stop_blind(self, pursuit: StopPursuit) -> None:
        """Without a link: write the stop where the failed link led, if it is due."""
        now = self._clock.mono_ns()
        if now < pursuit.next_mono_ns:
            self._pursuit = pursuit
            return
        self._pursuit = pursuit.sent_again(now)
        self._alarm(pursuit, moves=False)
        self._turned_mono_ns = now
        self._write_stop(self._failed_link)

    @staticmethod
    def _write_stop(link: LoadFrame | Stage | None) -> None:
        with contextlib.suppress(Exception):  # a port's blind stop never raises, but a driver may
            if isinstance(link, BlindStop):
                link.stop_blind()
            elif link is not None:
                link.stop()

    def _alarm(self, pursuit: StopPursuit, *, moves: bool) -> None:
        """The machine does not obey, or cannot be reached: only a person can stop it now. The terminal and the page repeat it."""
        now = self._clock.mono_ns()
        if not pursuit.alarm_due(now, moves):
            return
        self._pursuit = (self._pursuit or pursuit).with_alarm(moves)
        since_s = (now - pursuit.began_mono_ns) / 1e9
        if moves:
            what = f"it still moves {since_s:.1f} s after the first of {pursuit.sent} stop orders"
        else:
            what = f"no stop order was confirmed for {since_s:.1f} s, and it may move"
        reason = f"{what}: press the emergency stop of the machine"
        self._emit(DeviceFault(self._clock.now_ns(), self._device, reason, code=FaultCode.STOP_NOT_OBEYED))

    def _fail(self, reason: str) -> None:
        """This link is no good any more."""
        self._trouble = reason
        link = self._link
        if link is not None:
            if self._may_move or self._stop_owed:
                # What is read may be nonsense while orders are still taken; on a link that is down this fails at once.
                self._write_stop(link)
                now = self._clock.mono_ns()
                self._pursuit = (self._pursuit or begin_pursuit(now)).sent_again(now)
            if self._may_move and not self._stop_owed:
                self._stop_owed = True
                what = f"the link failed while it may have moved: {reason}; if it moves on, press its emergency stop"
                self._emit(DeviceStopped(self._clock.now_ns(), self._device, what, code=FaultCode.LINK_LOST))
            # A port's close never raises, but who wrote the driver may not have read that.
            with contextlib.suppress(Exception):
                link.close()
            self._failed_link = link
        self._link = self._port = None
        self._next_open_mono_ns = self._clock.mono_ns() + round(_BACKOFF_S[min(self._failures, len(_BACKOFF_S) - 1)] * 1e9)
        self._failures += 1

    def _check_dead_man(self, now_mono_ns: int) -> None:
        unfed_ns = now_mono_ns - self._fed_mono_ns
        if unfed_ns <= self._dead_man_ns:
            self._unfed = False
        elif not self._unfed:
            self._unfed = True
            with self._wake:
                self._orders.clear()
            self._stop_device()
            reason = f"control has not been heard of for {unfed_ns / 1e9:.1f} s"
            self._emit(DeviceStopped(self._clock.now_ns(), self._device, reason, code=FaultCode.CONTROL_LOST))

    def _check_age(self) -> None:
        age_s = self.sample_age_s
        if age_s > self._limits.stale_after_s and not self._stale and self._sampled_mono_ns is not None:
            self._stale = True
            self._emit(LinkStale(self._clock.now_ns(), self._device))
        if age_s > self._limits.lost_after_s and not self._lost and self._sampled_mono_ns is not None:
            self._lost = self._may_move = True
            reason = self._trouble or f"no reading for {age_s:.1f} s"
            self._emit(LinkLost(self._clock.now_ns(), self._device, reason))

    def _emit(self, event: Event) -> None:
        try:
            self._on_event(event)
        except Exception:
            # Nobody listens any more (a closed event loop raises RuntimeError): then nothing may move.
            self._stop_owed = True

    def _shut(self) -> None:
        """Stop and close; the device is pursued, and the link opened again if need be, until it rests or the time is over."""
        self._stop_owed = True
        began_mono_ns = self._last_read_mono_ns = self._clock.mono_ns()
        while self._stop_owed or self._pursuit is not None:
            self._last_look()
            now = self._clock.mono_ns()
            if now - began_mono_ns > _LAST_PURSUIT_S * 1e9 or now - self._last_read_mono_ns > _LAST_SILENCE_S * 1e9:
                break
            pause(_LAST_LOOK_S)
        self._rests = not self._stop_owed and self._pursuit is None
        if self._link is not None:
            with contextlib.suppress(Exception):
                self._link.close()
            self._link = None

    def _last_look(self) -> None:
        """One turn of the end: open, stop, read, judge."""
        if self._link is None and self._clock.mono_ns() >= self._next_open_mono_ns:
            self._attempt("opening the link to stop", self._open)
        if self._stop_owed:
            self._stop_device()
        port = self._port
        if port is not None and self._pursuit is not None and self._attempt("reading", lambda: self._look(port)):
            self._pursue(self._pursuit)

    def _look(self, port: Port) -> None:
        if self._pursuit is not None:
            self._pursuit = self._pursuit.with_sample(port.read())
            self._last_read_mono_ns = self._clock.mono_ns()
