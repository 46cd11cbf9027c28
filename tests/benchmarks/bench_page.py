"""What the live page costs and how fast it is: first paint, log to page, processor time with viewers, and what a week does to it.

    python tests/benchmarks/bench_page.py [--events 300] [--viewers 50] [--seconds 20] [--readings 500000]

The log is written by the real recorder in this process, which plays control: its processor time is what the page could cost control.
The page is the real process; the browser is the system's Chromium. Four parts:

- first paint: of a page with a complete experiment in its log, over loopback, by the browser's own measure, best, worst and median of ten;
- log to page: from the message handed to the recorder to the text in the document, for log lines with a transition, which is flushed at
  once; readings of the load are flushed once a second and are as old as that;
- viewers: processor time of the page's process, and of control with and without them, while 20 readings a second and events come;
- a week: readings and frames of a week are pressed into minutes; resident memory of the page's process, heap of the browser's page and
  how long a picture takes, at the middle and at the end.
"""

from __future__ import annotations

import argparse
import http.client
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from semlive.data.loading import MotionState
from semlive.formats.log.messages import (
    ElasticMessage,
    FileMessage,
    LoadSampleMessage,
    LogLineMessage,
    RunMessage,
    StateMessage,
)
from semlive.service.log.files import segment_path
from semlive.service.log.recording import Recorder
from semlive.service.runtime.clock import SystemClock

STATES = ("ramping", "settling", "holding", "imaging", "step_done")
TICK_S = 0.05
CONNECTED_S = 30.0  # in which every viewer has its first message
LONGEST = """() => new Promise((done) => {
    let last = performance.now(), worst = 0, left = 60;
    const next = (now) => {
        worst = Math.max(worst, now - last);
        last = now;
        left-- ? requestAnimationFrame(next) : done(worst);
    };
    requestAnimationFrame(next);
})"""


@dataclass(frozen=True)
class Shown:
    """A growing log with its page."""

    recorder: Recorder
    clock: SystemClock
    process: subprocess.Popen[bytes]
    address: str

    def reading(self, number: int, time_ns: int | None = None) -> None:
        now_ns = self.clock.now_ns() if time_ns is None else time_ns
        force_n = 400.0 + float(np.sin(number / 50.0))
        reported = LoadSampleMessage(
            sequence=number, time_ns=now_ns, mono_ns=time.monotonic_ns(), force_n=force_n, extension_mm=0.1, motion=MotionState.STOPPED,
            target_n=400.0, raw=(1, 2, 3, 4),
        )  # fmt: skip
        self.recorder.write("/load_frame/sample", reported, now_ns)

    def enter(self, number: int) -> None:
        after = STATES[number % len(STATES)]
        reported = StateMessage(time_ns=self.clock.now_ns(), before="ready", after=after, cause="start", step=0, guards={})
        self.recorder.write("/state", reported)

    def post_message(self, text: str) -> None:
        self.recorder.write("/log", LogLineMessage(time_ns=self.clock.now_ns(), level="info", text=text))
        # Lines are telemetry to the recorder; an event behind it takes it along.
        self.enter(int(time.monotonic() * 1000))

    def processor_s(self) -> float:
        """Processor time of the page's process so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / 100.0

    def memory_mb(self) -> float:
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


@contextmanager
def shown(folder: Path) -> Iterator[Shown]:
    clock = SystemClock()
    recorder = Recorder(segment_path(folder, "run", 0), clock, lambda what: sys.stderr.write(f"{what}\n"))
    recorder.write("/run", RunMessage(run="run", started_time_ns=clock.now_ns(), host="lab", versions={}, config={}))
    command = [sys.executable, "-m", "semlive.web", str(folder), "--host", "127.0.0.1", "--port", "0", "--exit-with-stdin"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    port = int(process.stdout.readline())
    try:
        yield Shown(recorder, clock, process, f"http://127.0.0.1:{port}/")
    finally:
        process.communicate()
        recorder.close()


@contextmanager
def chromium() -> Iterator[Browser]:
    path = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--enable-precise-memory-info"])


def first_paint(browser: Browser, one: Shown, paints: int) -> list[float]:
    """Milliseconds until the browser painted something of ours, with the caches of earlier visits emptied by a new context each time."""
    found = []
    for number in range(2000):
        one.reading(number)
    one.enter(0)
    time.sleep(1.0)
    for _ in range(paints):
        context = browser.new_context()
        fresh = context.new_page()
        fresh.goto(one.address, wait_until="load")
        fresh.wait_for_function("performance.getEntriesByName('first-contentful-paint').length > 0")
        found.append(float(fresh.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")))
        context.close()
    return found


def log_to_page(page: Page, one: Shown, events: int) -> list[float]:
    """Milliseconds from the recorder's door to the document, by this computer's own clock in both processes."""
    page.goto(one.address)
    page.evaluate(
        """() => {
            window.observed = [];
            new MutationObserver(() => window.observed.push([document.getElementById('message').textContent, Date.now()]))
                .observe(document.getElementById('message'), {childList: true, characterData: true, subtree: true});
        }"""
    )
    reported: dict[str, float] = {}
    for number in range(events):
        reported[f"event {number}"] = 1e3 * time.time()
        one.post_message(f"event {number}")
        one.reading(number)
        page.wait_for_timeout(int(1e3 * (0.06 + 0.05 * ((number * 0.618) % 1.0))))
    page.wait_for_timeout(1000)
    observed = dict(page.evaluate("window.observed"))
    return [observed[text] - at_ms for text, at_ms in reported.items() if text in observed]


@dataclass
class Viewer:
    """Reads the stream as a browser does, and counts."""

    address: str
    received: int = 0
    over: bool = False

    def look(self) -> None:
        line = http.client.HTTPConnection(self.address.removeprefix("http://").strip("/"), timeout=10)
        line.request("GET", "/events")
        reply = line.getresponse()
        while not self.over and (data := reply.read1(65536)):
            self.received += len(data)
        line.close()


def cost(one: Shown, viewers: int, seconds: float) -> tuple[float, float, float]:
    """Processor time of the page's process and of control, which is this one, as fractions of a core; and kB/s a viewer."""
    looking = [Viewer(one.address) for _ in range(viewers)]
    script = "import sys;sys.path.insert(0,sys.argv[1]);from bench_page import many;many(sys.argv[2],int(sys.argv[3]))"
    crowd = subprocess.Popen(
        [sys.executable, "-c", script, str(Path(__file__).parent), one.address, str(len(looking))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert crowd.stdout is not None
    crowd.stdout.readline()
    began_s, page_s, control_s = time.monotonic(), one.processor_s(), time.process_time()
    number = 0
    while time.monotonic() < began_s + seconds:
        one.reading(number)
        if number % 20 == 0:
            one.enter(number // 20)
        number += 1
        time.sleep(TICK_S)
    took_s = time.monotonic() - began_s
    spent = (one.processor_s() - page_s) / took_s, (time.process_time() - control_s) / took_s
    received, _ = crowd.communicate()
    return *spent, int(received) / 1e3 / took_s / max(1, viewers)


def many(address: str, count: int) -> None:
    """Viewers in a process of their own, until its standard input ends; reports how much they received."""
    looking = [Viewer(address) for _ in range(count)]
    for viewer in looking:
        threading.Thread(target=viewer.look, daemon=True).start()
    deadline_s = time.monotonic() + CONNECTED_S
    while not all(viewer.received for viewer in looking) and time.monotonic() < deadline_s:
        time.sleep(TICK_S)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    before = sum(viewer.received for viewer in looking)
    sys.stdin.read()
    sys.stdout.write(f"{sum(viewer.received for viewer in looking) - before}\n")


def week(page: Page, one: Shown, readings: int) -> list[tuple[int, float, float, float]]:
    """Readings sent, memory of the page's process (MB), heap of the browser's page (MB) and its slowest drawing (ms), at four instants."""
    page.goto(one.address)
    rows, start_ns = [], one.clock.now_ns()
    spacing_ns = round(7 * 86400 * 1e9 / readings)
    for number in range(readings):
        one.reading(number, start_ns + number * spacing_ns)
        if number % 500 == 0:
            export = number // 500
            one.recorder.write("/sem/file", file(export, "arrived", ""))
            one.recorder.write("/sem/file", file(export, "refused", "its scan began before the hold was over"))
            one.recorder.write("/elastic", ElasticMessage(revision=export))
            one.enter(export)
            page.wait_for_timeout(1)
        if (number + 1) % (readings // 4) == 0:
            page.wait_for_timeout(1200)
            page.context.new_cdp_session(page).send("HeapProfiler.collectGarbage")
            heap = page.evaluate("performance.memory.usedJSHeapSize / 2**20")
            slow = page.evaluate(LONGEST)
            rows.append((number + 1, one.memory_mb(), float(heap), float(slow)))
    return rows


def file(export: int, decision: str, reason: str) -> FileMessage:
    return FileMessage(
        export=export, name=f"scan_{export:05d}.tif", size=1, sha256="", mtime_ns=0, arrival_time_ns=0, decision=decision, reason=reason
    )


def parsed_arguments(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="What the live page costs and how fast it is.")
    parser.add_argument("--paints", type=int, default=10)
    parser.add_argument("--events", type=int, default=300)
    parser.add_argument("--viewers", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--readings", type=int, default=500_000)
    return parser.parse_args(arguments)


def measure(browser: Browser, arguments: argparse.Namespace) -> None:
    with tempfile.TemporaryDirectory() as root, browser.new_page(viewport={"width": 1440, "height": 900}) as page:
        for name in ("a", "b"):
            (Path(root) / name).mkdir()
        with shown(Path(root) / "a") as one:
            paints = first_paint(browser, one, arguments.paints)
            report(f"first paint: {min(paints):.0f} to {max(paints):.0f} ms, median {np.median(paints):.0f} ms (bar: 1000)")
            delays = log_to_page(page, one, arguments.events)
            p50, p99 = np.percentile(delays, [50, 99])
            counted = f"{len(delays)} of {arguments.events} events"
            report(f"log to page: {counted}, median {p50:.0f} ms, p99 {p99:.0f} ms, most {max(delays):.0f} ms (bar: 200)")
            page.goto("about:blank")
            for viewers in (0, arguments.viewers):
                web, control, rate = cost(one, viewers, arguments.seconds)
                spent = f"page's process {100 * web:.1f} %, control {100 * control:.1f} % of a core (bar: 5)"
                report(f"{viewers} viewers: {spent}, {rate:.1f} kB/s each")
        with shown(Path(root) / "b") as one:
            for reported, memory, heap, slow in week(page, one, arguments.readings):
                days = 7.0 * reported / arguments.readings
                stored = f"page's process {memory:.0f} MB, browser's heap {heap:.1f} MB"
                report(f"day {days:.1f}: {stored}, longest between two pictures {slow:.0f} ms")


def report(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    with chromium() as opened:
        measure(opened, parsed_arguments())
