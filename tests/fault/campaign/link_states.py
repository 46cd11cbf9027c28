"""States of the load frame and of the run that several faults begin with or end in."""

from __future__ import annotations

import re
import time

from lab import Lab, until

SOON_MS = 400.0
"""Largest time from a reading beyond a limit to rest: one polling period (50 ms), the stop, and a busy computer."""
WATCHDOG_MS = 2600.0
"""Largest time to rest by the watchdog of the device (2 s), fed up to 0.1 s before, on a busy computer."""


def in_fault(lab: Lab, pattern: str, *, after: str = "ramping") -> str:
    """Require that the run went into a fault and ended by itself; returns the message."""
    code, output = lab.end()
    states = lab.states()
    assert code == 1, output
    assert "fault" in states or "estopped" in states, states
    assert after in states
    reported = f"{output} | {lab.reported()}"
    assert re.search(pattern, reported), reported
    lab.require_complete_log()
    assert not lab.logged("/pair")
    return next((fault["what"] for fault in lab.logged("/fault") if re.search(pattern, fault["what"])), _message(output, pattern))


def _message(output: str, pattern: str) -> str:
    """The message in the output, between the marks of warnings and the progress lines."""
    match = re.search(rf"! ([^!]*{pattern}[^!:]*)", output)
    return match[1].strip() if match else pattern


def ramping(lab: Lab) -> float:
    """Start the daemon and wait until the stand moves; returns the time (monotonic s)."""
    lab.start().reach("ramping")
    until(lambda: lab.stand.moving and abs(lab.stand.force_n) > 20, "the stand moves")
    return time.monotonic()


def stopped(lab: Lab, since_s: float, within_ms: float, by: str) -> float:
    took_ms = lab.stopped_ms(since_s)
    assert took_ms <= within_ms, f"it took {took_ms:.0f} ms"
    why = next(why for at_s, why in lab.stand.stops if at_s >= since_s)
    assert re.search(by, why), why
    return took_ms
