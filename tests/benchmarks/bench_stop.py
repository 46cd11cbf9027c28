"""From the reading that violates a limit to the stop command on the wire, while correlation keeps every processor busy.

    python tests/benchmarks/bench_stop.py [--runs 100] [--workers 2] [--write FILE.json]

The daemon's link thread and its Modbus TCP driver poll a load frame at 20 Hz (the daemon's own period), next to `--workers` processes
that correlate frames of the paper's size (1024 x 884 px) without a pause. The frame is a process of its own: it begins to report a force
beyond the limit at a random instant, and notes when that reading left and when the next stop arrived, by one clock. Prints one JSON object:
median, 99 % and worst in ms from the reading, and from the violation itself (which adds up to one polling period).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import select
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from semlive.data.experiment import Limits
from semlive.engine.events import Device, Event, LinkLost
from semlive.service.device_link import DeviceLink
from semlive.service.runtime.clock import SystemClock
from semlive.service.runtime.drivers import open_load_frame

CAMPAIGN = Path(__file__).resolve().parents[1] / "fault" / "campaign"
POLL_S = 0.05

_FRAME = """
import sys, time
sys.path.insert(0, sys.argv[1])
from stand import Stand, TcpPort
stand = Stand()
door = TcpPort(stand)
print(door.port, flush=True)
first_reading_s = [0.0]
def answer(pdu, real=stand.answer):
    reply = real(pdu)
    if first_reading_s[0] == 0.0 and pdu[0] == 4 and int.from_bytes(pdu[1:3]) <= 4 and stand.sensor(0.0) > 900:
        first_reading_s[0] = time.monotonic()
    return reply
stand.answer = answer
stopped = []
def halt(why, real=stand.halt):
    stopped.append(time.monotonic())
    real(why)
stand.halt = halt
for line in sys.stdin:
    first_reading_s[0] = 0.0
    stand.force_n = 0.0
    stand.sensor = lambda force_n: force_n
    stand.move(800.0, 1.0)
    time.sleep(float(line))
    stopped.clear()
    began = time.monotonic()
    stand.sensor = lambda force_n: 1000.0
    while not (first_reading_s[0] and stopped and stopped[-1] >= first_reading_s[0]) and time.monotonic() < began + 5.0:
        time.sleep(0.0005)
    after = [at_s for at_s in stopped if first_reading_s[0] and at_s >= first_reading_s[0]]
    print(*(after[0] - first_reading_s[0], after[0] - began) if after else (-1.0, -1.0), flush=True)
    stand.sensor = lambda force_n: force_n
    time.sleep(0.3)
"""


def _correlate() -> None:
    """Correlate without a pause; never returns."""
    from semlive.dic import match  # noqa: PLC0415

    chance = np.random.default_rng(1)
    grey = np.kron(chance.normal(size=(296, 342)), np.ones((3, 3)))[:884, :1024] * 45.0 + 128.0
    first = np.clip(grey, 0, 255).astype(np.uint8)
    second = np.clip(np.roll(grey, 1, axis=1) + chance.normal(size=grey.shape), 0, 255).astype(np.uint8)
    match(first, second)
    sys.stdout.write("warm\n")
    sys.stdout.flush()
    while True:
        match(first, second)


def measured(runs: int, workers: int) -> dict[str, object]:
    """Violate the limit so many times."""
    busy = [subprocess.Popen([sys.executable, __file__, "--correlate"], stdout=subprocess.PIPE, text=True) for _ in range(workers)]
    frame = subprocess.Popen([sys.executable, "-c", _FRAME, str(CAMPAIGN)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert frame.stdin is not None
    assert frame.stdout is not None
    try:
        for item in busy:
            assert item.stdout is not None
            item.stdout.readline()
        port = int(frame.stdout.readline())
        limits = Limits(-50.0, 900.0, -1.0, 1.0, 50.0, 900.0, 100.0)
        events: list[Event] = []
        clock = SystemClock()
        link = DeviceLink(
            Device.LOAD_FRAME,
            lambda: open_load_frame("modbus", {"map": "bench", "port": port}, clock),
            events.append,
            clock=clock,
            limits=limits,
            poll_s=POLL_S,
        )
        link.open()
        chance, from_reading, from_violation = random.Random(1), [], []
        for _ in range(runs):
            frame.stdin.write(f"{chance.uniform(0.3, 0.5)}\n")
            frame.stdin.flush()
            while not _ready(frame):
                link.keep_alive()
                time.sleep(POLL_S)
            reading_s, violation_s = (float(word) for word in frame.stdout.readline().split())
            assert reading_s >= 0.0, f"no stop within 5 s; {events[-3:]}"
            from_reading.append(1e3 * reading_s)
            from_violation.append(1e3 * violation_s)
        link.close()
    finally:
        for item in (*busy, frame):
            item.kill()
            item.wait()
    return {
        "runs": runs,
        "workers": workers,
        "processors": os.cpu_count(),
        "load_average": round(os.getloadavg()[0], 1),
        "polling_ms": 1e3 * POLL_S,
        "links_lost": sum(isinstance(item, LinkLost) for item in events),
        "from_reading_ms": _figures(from_reading),
        "from_violation_ms": _figures(from_violation),
    }


def _ready(process: subprocess.Popen[str]) -> bool:
    assert process.stdout is not None
    return bool(select.select([process.stdout], [], [], 0)[0])


def _figures(values: list[float]) -> dict[str, float]:
    names = ("median", "p99", "worst")
    return dict(zip(names, (round(float(item), 1) for item in np.percentile(values, [50, 99, 100])), strict=True))


def main() -> int:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", type=Path, default=None)
    parser.add_argument("--correlate", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.correlate:
        _correlate()
    found = measured(options.runs, options.workers)
    sys.stdout.write(json.dumps(found) + "\n")
    if options.write is not None:
        options.write.write_text(json.dumps(found) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
