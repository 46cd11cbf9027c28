"""Sends alerts in a thread of its own: a slow or dead network can neither delay the run nor stop it."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable

from semlive.errors import BadLog
from semlive.formats.log.messages import from_json
from semlive.formats.log.reader import LogMessage
from semlive.service.alerts.events import Alert, alert_of
from semlive.service.alerts.targets import AlertTarget, send
from semlive.service.config.sections import AlertEvent

TOPICS = frozenset(("/fault", "/state", "/operator"))
_RETRIES_S = (0.0, 5.0, 30.0)
"""Waits before the attempts, s."""
_MAX_WAITING = 64
_MAX_ALERTS = 20
_WINDOW_S = 600.0
"""At most `_MAX_ALERTS` alerts are sent within this time; a fault that repeats must not fill a mailbox."""
_CLOSE_S = 20.0


class AlertSender:
    """Follows the log of a run and sends alerts.

    Args:
        targets: addresses.
        events: kinds of events to report.
        run: name of the run.
        report: callback for an alert that could not be sent, one sentence; called in the thread of the sender.
        retries_s: waits before the attempts, s.
    """

    def __init__(
        self,
        targets: tuple[AlertTarget, ...],
        events: frozenset[AlertEvent],
        run: str,
        report: Callable[[str], object],
        retries_s: tuple[float, ...] = _RETRIES_S,
    ) -> None:
        self._targets, self._events, self._run, self._report, self._retries_s = targets, events, run, report, retries_s
        self._alerts: queue.Queue[Alert | None] = queue.Queue(_MAX_WAITING)
        self._times_s: deque[float] = deque(maxlen=_MAX_ALERTS)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._send_all, name="alerts", daemon=True)
        self._thread.start()

    def on_message(self, message: LogMessage) -> None:
        """Queue the alert about a message of the log, if there is one; never blocks."""
        if message.topic not in TOPICS:
            return
        try:
            alert = alert_of(from_json(message.topic, message.payload), self._run)
        except BadLog:
            return
        if alert is not None and alert.event in self._events:
            self._queue(alert)

    @property
    def idle(self) -> bool:
        """Whether every queued alert was sent or given up."""
        return self._alerts.unfinished_tasks == 0

    def close(self) -> None:
        """Send what is queued, for at most 20 s, and end."""
        self._closing.set()
        try:
            self._alerts.put(None, timeout=_CLOSE_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_S)

    def _queue(self, alert: Alert) -> None:
        now_s = time.monotonic()
        if alert.event is not AlertEvent.END and len(self._times_s) == _MAX_ALERTS and now_s - self._times_s[0] < _WINDOW_S:
            return
        self._times_s.append(now_s)
        if len(self._times_s) == _MAX_ALERTS and now_s - self._times_s[0] < _WINDOW_S:
            alert = Alert(alert.event, alert.title, f"{alert.text} Further alerts are held back for {_WINDOW_S / 60:.0f} min.")
        try:
            self._alerts.put_nowait(alert)
        except queue.Full:
            self._report(f"the alert '{alert.title}' was not sent: {_MAX_WAITING} others are waiting")

    def _send_all(self) -> None:
        while (alert := self._alerts.get()) is not None:
            failed = self._failed(alert)
            if failed:
                where = ", ".join(target.label for target in failed)
                self._report(f"the alert '{alert.title}' was not accepted by {where} of alerts.file; check address and network")
            self._alerts.task_done()

    def _failed(self, alert: Alert) -> tuple[AlertTarget, ...]:
        """Send an alert; returns the addresses that did not accept it in any attempt."""
        remaining = self._targets
        for wait_s in self._retries_s:
            # While the run ends there is one attempt only.
            if wait_s and self._closing.wait(wait_s):
                break
            remaining = tuple(target for target in remaining if not send(target, alert.title, alert.text, alert.event))
            if not remaining:
                break
        return remaining
