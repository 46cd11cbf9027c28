"""One thread for each device link. Only this thread accesses the device, and it stops the device without a command if necessary.

Order of precedence in every cycle: the dead-man timeout, a pending stop, commands, the next reading. A device call blocks for at most the
timeout of the driver, so a stop waits for at most one answer. The thread never begins a motion without a command.

After a stop, the stop command is repeated until the readings show that the device is at rest (`stop_pursuit`). If a request fails while the
device may move, the stop is first written without waiting for an answer, on the old connection and on a new one, repeatedly until a link is
open. Only then is a reading requested: a device may execute commands that it cannot answer.
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
_MAX_SLEEP_S = 0.05
# While a link is closed: longest time of repeated stops, longest time without a reading, and polling interval. A reading over a slow
# gateway takes a second, and three readings show rest.
_CLOSE_PURSUIT_S = 10.0
_CLOSE_SILENCE_S = 4.0
_CLOSE_POLL_S = 0.05


class DeviceLink:
    """Link to one device, with its thread, from opening to closing.

    Args:
        device: kind of the device, for events.
        open_device: opens a new link at each call; called in the thread only.
        on_event: callback for engine events, in the thread; must not block. If it raises, the device is stopped.
        clock: experiment time and the monotonic clock.
        limits: soft limits, checked here for every sample, as in the engine; also the ages at which a sample is stale or the link lost.
        poll_s: wall time between readings, s.
        dead_man_s: longest wall time between calls of `keep_alive`, s; beyond it the device is stopped.
        recalled: last ramp in the log of a resumed run, to be compared with the command in the device. None: a new run.
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
        self._stop_requested = False
        self._closing = False
        self._alive_mono_ns = clock.mono_ns()
        self._sampled_mono_ns: int | None = None
        self._cycle_mono_ns = clock.mono_ns()

        # Used by the thread only.
        self._thread = threading.Thread(target=self._run, name=f"link to {device.words}", daemon=True)
        self._opened = threading.Event()
        self._open_error: Exception | None = None
        self._identity: DeviceIdentity | None = None
        self._stage_kind: StageKind | None = None
        self._link: LoadFrame | Stage | None = None
        self._port: Port | None = None
        self._failed_link: LoadFrame | Stage | None = None
        self._pursuit: StopPursuit | None = None
        self._stop_pending = False
        self._may_move = False
        self._beyond_limit = False
        self._control_silent = False
        self._stale = False
        self._lost = False
        self._trouble = ""
        self._failures = 0
        self._next_open_mono_ns = self._last_read_mono_ns = 0
        self._next_poll_mono_ns = 0
        self._at_rest = self._failing = False
        self._reading_count: int | None = None

    # ------------------------------------------------------------------ for control

    def open(self, timeout_s: float = 10.0) -> DeviceIdentity:
        """Start the thread and wait until the device has answered.

        Raises:
            LinkRefused: if the device does not answer in time.
            LinkError: if another device answers, or the answer is invalid.
            BadConfig: if the driver rejects its settings.
        """
        self.keep_alive()
        self._thread.start()
        if not self._opened.wait(timeout_s):
            self.close(0.0)
            raise LinkRefused(f"the {self._device.words} did not answer within {timeout_s:g} s; check that it is on and connected")
        if self._open_error is not None:
            raise self._open_error
        self.keep_alive()
        return self.identity

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of the device when the link was first opened."""
        if self._identity is None:
            raise RuntimeError("the link is not open")
        return self._identity

    @property
    def stage_kind(self) -> StageKind | None:
        """Whether a stage moves the specimen or the beam; None for a load frame, and before the link is opened."""
        return self._stage_kind

    def order_problem(self, ramps: Iterable[tuple[float, float]]) -> str | None:
        """Return why one of the ramps (target in N, rate in N/s) cannot be ordered exactly, or None.

        Sends nothing; to be called right after opening.
        """
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
        """Wall time since the thread called its driver or began a cycle, s; it increases while a driver call does not return."""
        return (self._clock.mono_ns() - self._cycle_mono_ns) / 1e9 if self._thread.is_alive() and self._opened.is_set() else 0.0

    def keep_alive(self) -> None:
        """Signal that control is alive."""
        with self._wake:
            self._alive_mono_ns = self._clock.mono_ns()

    def send(self, command: Order) -> None:
        """Queue a motion command; returns at once. CommandAcknowledged or DeviceFault follows, unless a stop comes first."""
        with self._wake:
            self._orders.append(command)
            self._wake.notify_all()

    def stop(self, reason: str) -> None:
        """Stop motion before any other action and discard queued commands; returns at once."""
        del reason  # the caller records it
        with self._wake:
            self._orders.clear()
            self._stop_requested = True
            self._wake.notify_all()

    def close(self, timeout_s: float = 12.0) -> bool:
        """Stop motion, close the link and end the thread; never raises, may be called repeatedly.

        Returns:
            True if the readings after the last stop show rest, or if the link was never open; False if it is
            unknown whether the device is at rest.
        """
        with self._wake:
            self._orders.clear()
            # There is no second wait for a thread that did not end in time.
            timeout_s, self._closing = 0.0 if self._closing else timeout_s, True
            self._wake.notify_all()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout_s)
        return self._identity is None or (self._at_rest and not self._thread.is_alive())

    # ------------------------------------------------------------------ the thread

    def _run(self) -> None:
        try:
            self._open()
        except Exception as error:
            # An exception of the driver during opening is raised by open().
            self._open_error = error
            self._opened.set()
            return
        self._cycle_mono_ns = self._clock.mono_ns()
        self._opened.set()
        while not self._closing:
            self._guarded(self._cycle)
            self._sleep()
        self._guarded(self._shut_down)

    def _guarded(self, call: Callable[[], None]) -> None:
        """Call a function and, after an exception, stop the device and continue: only this thread can stop the device."""
        try:
            call()
            self._failing = False
        except Exception as error:
            self._stop_pending = True
            repeated, self._failing = self._failing, True
            reason = f"its link thread made a mistake: {error!r}"
            with contextlib.suppress(Exception):
                event = DeviceFault(self._clock.now_ns(), self._device, reason, code=FaultCode.INTERNAL_ERROR)
                None if repeated else self._emit(event)
            pause(_MAX_SLEEP_S)

    def _cycle(self) -> None:
        now = self._cycle_mono_ns = self._clock.mono_ns()
        self._check_dead_man(now)
        with self._wake:
            self._stop_pending, self._stop_requested = self._stop_pending or self._stop_requested, False
        if self._link is None:
            self._reopen(now)
        if self._stop_pending:
            self._stop_device()
        elif self._pursuit is not None:
            self._pursue(self._pursuit)
        elif self._link is not None:
            self._execute_next()
        if self._link is not None and not self._stop_requested and self._clock.mono_ns() >= self._next_poll_mono_ns:
            self._next_poll_mono_ns = self._clock.mono_ns() + self._poll_ns
            self._attempt("reading", self._poll)
        self._check_age()

    def _reopen(self, now_mono_ns: int) -> None:
        """Open the link again; a pending stop is written before anything is read from the device."""
        if self._stop_pending:
            self._stop_device()
        if now_mono_ns >= self._next_open_mono_ns:
            self._attempt("opening the link again", self._open)

    def _sleep(self) -> None:
        """Sleep until the next reading is due or control sends a command."""
        with self._wake:
            if self._stop_requested or self._closing or (self._orders and self._link is not None and self._pursuit is None):
                return
            until_s = (self._next_poll_mono_ns - self._clock.mono_ns()) / 1e9 if self._link is not None else _MAX_SLEEP_S
            if until_s > 0:
                self._wake.wait(min(until_s, _MAX_SLEEP_S))

    def _attempt(self, action: str, call: Callable[[], None]) -> bool:
        """Call the device; an error closes this link, and the next cycle opens a new one."""
        self._cycle_mono_ns = self._clock.mono_ns()
        try:
            call()
        except Exception as error:
            # An error in a driver must not end the thread, because only it can stop the device.
            self._fail(str(error) if isinstance(error, LinkError) else f"{action} failed in the driver: {error!r}")
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
        self._stage_kind = None if isinstance(link, LoadFrame) else link.kind
        if self._may_move:
            self._stop_pending = True

    def _poll(self) -> None:
        port = self._port
        if port is None:
            return
        first = self._sampled_mono_ns is None
        request_ns = time.monotonic_ns()
        sample = port.read()
        sample = replace(sample, rtt_s=(time.monotonic_ns() - request_ns) / 1e9)
        problem = port.problem(sample)
        finding: Finding | None = None
        if problem is not None and not self._beyond_limit:
            finding = problem
        elif first and sample.motion is MotionState.MOVING:
            finding = Finding(FaultCode.UNORDERED_MOTION, "it moved before a motion was ordered")
        self._beyond_limit = problem is not None
        if finding is not None:
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
        if finding is not None:
            self._emit_stop(sample, finding)
        self._check_restart(sample)

    def _emit_stop(self, sample: LoadSample | StageSample, finding: Finding) -> None:
        """Emit the event of a stop: DeviceStopped for findings that the engine also derives from the reading, else DeviceFault."""
        device_stopped = finding.code in (FaultCode.LIMIT, FaultCode.UNORDERED_MOTION)
        event = DeviceStopped if device_stopped else DeviceFault
        self._emit(event(sample.time_ns, self._device, finding.reason, code=finding.code))

    def _check_restart(self, sample: LoadSample | StageSample) -> None:
        """Emit a fault if the reading counter shows a restart: the device has lost its orders and perhaps its zero."""
        if not isinstance(sample, LoadSample) or sample.counted is None:
            return
        count, modulus = sample.counted
        previous, self._reading_count = self._reading_count, count
        if previous is not None and (count - previous) % modulus > modulus // 2:
            what = f"it was restarted: its counter of readings went from {previous} to {count}; check its zero, position and settings"
            self._emit(DeviceFault(sample.time_ns, self._device, what, code=FaultCode.DEVICE_RESTARTED))

    def _execute_next(self) -> None:
        with self._wake:
            order = self._orders.popleft() if self._orders else None
        if order is None or self._port is None:
            return
        if self._control_silent:
            self._emit(
                DeviceFault(
                    self._clock.now_ns(), self._device, "a command came while control was not feeding the link", code=FaultCode.CONTROL_LOST
                )
            )
            return
        self._may_move, self._beyond_limit = True, False
        self._cycle_mono_ns = self._clock.mono_ns()
        try:
            self._port.obey(order)
        except Exception as error:
            self._stop_pending = True
            self._emit(DeviceFault(self._clock.now_ns(), self._device, str(error), code=FaultCode.ORDER_REFUSED))
            return
        self._emit(CommandAcknowledged(self._clock.now_ns(), self._device))

    def _stop_device(self) -> None:
        """Stop the device and begin the pursuit; a failed stop remains pending and is sent first when the link is open again."""
        self._stop_pending = True
        now = self._clock.mono_ns()
        pursuit = self._pursuit or begin_pursuit(now)
        port = self._port
        if port is None:
            self._stop_blind(pursuit)
            return
        self._pursuit = pursuit.sent_again(now)
        if self._attempt("stopping", port.stop):
            self._stop_pending = False

    def _pursue(self, pursuit: StopPursuit) -> None:
        """Repeat the stop while the device moves; the pursuit ends when it is at rest."""
        now, motionless = self._clock.mono_ns(), None if self._port is None else self._port.still()
        if pursuit.rests(motionless):
            self._pursuit = None
            return
        if pursuit.moves(motionless):
            self._alarm(pursuit, moves=True)
        if pursuit.due(now, motionless):
            self._stop_device()

    def _stop_blind(self, pursuit: StopPursuit) -> None:
        """Without a link: write the stop to the address of the failed link, if it is due."""
        now = self._clock.mono_ns()
        if now < pursuit.next_mono_ns:
            self._pursuit = pursuit
            return
        self._pursuit = pursuit.sent_again(now)
        self._alarm(pursuit, moves=False)
        self._cycle_mono_ns = now
        self._write_stop(self._failed_link)

    @staticmethod
    def _write_stop(link: LoadFrame | Stage | None) -> None:
        with contextlib.suppress(Exception):  # the blind stop of a port never raises, but a driver may
            if isinstance(link, BlindStop):
                link.stop_blind()
            elif link is not None:
                link.stop()

    def _alarm(self, pursuit: StopPursuit, *, moves: bool) -> None:
        """Emit STOP_NOT_OBEYED if it is due: the machine moves on or cannot be reached, so a person must stop it."""
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
        """Close a failed link; stop the device first if it may move."""
        self._trouble = reason
        link = self._link
        if link is not None:
            if self._may_move or self._stop_pending:
                # The device may still execute orders although its answers are invalid; on a broken link this fails at once.
                self._write_stop(link)
                now = self._clock.mono_ns()
                self._pursuit = (self._pursuit or begin_pursuit(now)).sent_again(now)
            if self._may_move and not self._stop_pending:
                self._stop_pending = True
                what = f"the link failed while it may have moved: {reason}; if it moves on, press its emergency stop"
                self._emit(DeviceStopped(self._clock.now_ns(), self._device, what, code=FaultCode.LINK_LOST))
            # The close of a port must not raise, but a driver may violate that rule.
            with contextlib.suppress(Exception):
                link.close()
            self._failed_link = link
        self._link = self._port = None
        self._next_open_mono_ns = self._clock.mono_ns() + round(_BACKOFF_S[min(self._failures, len(_BACKOFF_S) - 1)] * 1e9)
        self._failures += 1

    def _check_dead_man(self, now_mono_ns: int) -> None:
        silent_ns = now_mono_ns - self._alive_mono_ns
        if silent_ns <= self._dead_man_ns:
            self._control_silent = False
        elif not self._control_silent:
            self._control_silent = True
            with self._wake:
                self._orders.clear()
            self._stop_device()
            reason = f"control has not been heard of for {silent_ns / 1e9:.1f} s"
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
            # Control no longer receives events (a closed event loop raises RuntimeError): then nothing may move.
            self._stop_pending = True

    def _shut_down(self) -> None:
        """Stop the device and close the link; repeat stops, and reopen the link, until the device is at rest or the time is over."""
        self._stop_pending = True
        began_mono_ns = self._last_read_mono_ns = self._clock.mono_ns()
        while self._stop_pending or self._pursuit is not None:
            self._close_cycle()
            now = self._clock.mono_ns()
            if now - began_mono_ns > _CLOSE_PURSUIT_S * 1e9 or now - self._last_read_mono_ns > _CLOSE_SILENCE_S * 1e9:
                break
            pause(_CLOSE_POLL_S)
        self._at_rest = not self._stop_pending and self._pursuit is None
        if self._link is not None:
            with contextlib.suppress(Exception):
                self._link.close()
            self._link = None

    def _close_cycle(self) -> None:
        """Run one cycle of closing: open the link, stop the device, read and evaluate a sample."""
        if self._link is None and self._clock.mono_ns() >= self._next_open_mono_ns:
            self._attempt("opening the link to stop", self._open)
        if self._stop_pending:
            self._stop_device()
        port = self._port
        if port is not None and self._pursuit is not None and self._attempt("reading", lambda: self._read_pursuit(port)):
            self._pursue(self._pursuit)

    def _read_pursuit(self, port: Port) -> None:
        if self._pursuit is not None:
            self._pursuit = self._pursuit.with_sample(port.read())
            self._last_read_mono_ns = self._clock.mono_ns()
