"""A complete simulated experiment, watched and steered from the page in a real browser."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, expect

from semlive.formats.log.writer import LogWriter
from semlive.service.log.files import messages

Tab = Callable[..., Page]
Shoot = Callable[[Page, str], None]
Readable = Callable[[Page], None]


def state(page: Page, text: str, timeout_s: float = 100.0) -> None:
    expect(page.locator("#state-word")).to_have_text(text, timeout=1000 * timeout_s)


def states(page: Page) -> int:
    """Number of state texts that the page has shown so far."""
    return int(page.evaluate("window.states.length"))


def shown(page: Page, text: str, since: int) -> None:
    """The state text was shown since then."""
    page.wait_for_function("([text, since]) => window.states.slice(since).includes(text)", arg=[text, since], timeout=100_000)


def test_an_experiment_is_watched_steered_interrupted_and_completed(
    bench: Callable[[str], Any], tab: Tab, shoot: Shoot, readable: Readable
) -> None:
    run = bench("watched")
    run.config["protocol"]["hold_s"] = 180.0  # 6 s in which the page is looked at; a busy computer needed more than 3 s
    address = run.start()
    port = int(re.search(r":(\d+)/", address)[1])
    page = tab()
    page.goto(address)
    expect(page).to_have_url(address.partition("#")[0])
    state(page, "holding")
    expect(page.locator("#step")).to_have_text("step 1 of 5, calibration")
    expect(page.locator("#countdown")).to_have_text(re.compile(r"^\d+ s left$"))
    expect(page.locator("#plan tr[aria-current]")).to_contain_text("now")
    page.get_by_role("button", name="Abort…").click()
    page.get_by_role("button", name="Continue").click()
    page.get_by_role("button", name="Pause").click()
    state(page, "paused")
    expect(page.get_by_role("alert")).to_contain_text("Resume repeats the step with its complete hold")
    expect(page.get_by_role("button", name="Stop")).to_be_enabled()
    page.get_by_role("button", name="Resume").click()
    # A second pair, so that the resumed run has an earlier pair.
    expect(page.locator("#plan tr.done")).to_have_count(1, timeout=60_000)
    state(page, "holding")
    run.process.send_signal(signal.SIGKILL)
    run.end()
    expect(page.locator("#connection")).to_contain_text("no connection", timeout=60_000)

    again = run.start("--resume", port=port)
    state(page, "waiting for confirmation")
    expect(page.locator("#connection")).to_be_hidden()
    page.get_by_role("button", name="Resume").click()
    expect(page.locator("#answer")).to_contain_text("the token is not that of this run")
    page.get_by_role("button", name="Resume").click()
    page.get_by_role("textbox", name="Token").fill(again.partition("#token=")[2])
    since = states(page)
    page.get_by_role("button", name="Keep it in this tab").click()
    for word in ("holding", "imaging"):
        shown(page, word, since)
        shoot(page, word)
    expect(page.locator("#step")).to_have_text("step 5 of 5, tension 800 N", timeout=240_000)
    completed(run, page)
    shoot(page, "complete")
    assert run.end() == 0, run.printed
    printed = [reported["what"] for reported in run.logged("/operator")]
    assert printed == ["start", "pause", "resume", "resume"]
    with served(run.log) as shows:
        tablet = tab(viewport={"width": 820, "height": 1180})
        looked_at(tablet, shows, shoot)
        readable(tablet)
    with served(log_before_states(run)) as shows:
        page = tab()
        page.goto(shows)
        state(page, "idle")
        expect(page.locator("#plan tr")).to_have_count(5)
        shoot(page, "idle")


def log_before_states(run: Any) -> Path:
    """A run's log as it is before the first state."""
    path = run.folder / "before.mcap"
    with path.open("wb") as stream:
        writer = LogWriter(stream)
        for reported in takewhile(lambda message: message.topic != "/state", messages(run.log)):
            writer.write(reported.topic, reported.payload, reported.log_time_ns, reported.publish_time_ns)
        writer.finish()
    return path


def completed(run: Any, page: Page) -> None:
    """The end of the run is on the page before the daemon takes the page away: results, maps, texts."""
    state(page, "complete")
    expect(page.locator("#plan tr.done")).to_have_count(5)
    expect(page.locator("#map-which")).to_have_text("9: tension 800 N", timeout=90_000)
    expect(page.locator("#elastic")).to_contain_text(re.compile(r"E[\d.]+ ± [\d.]+ GPa"))


@contextmanager
def served(log: Path) -> Iterator[str]:
    """`semlive serve`, and its address."""
    command = [sys.executable, "-m", "semlive", "serve", str(log), "--page-port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        yield process.stderr.readline().partition("live page: ")[2].strip()
        process.send_signal(signal.SIGINT)
        assert process.wait(100) == 0


def looked_at(page: Page, address: str, shoot: Shoot) -> None:
    """A finished log on a tablet: nothing to steer, everything to look at, with keys alone."""
    page.goto(address)
    state(page, "complete")
    expect(page.locator("#controls")).to_be_hidden()
    expect(page.locator("#map-which")).to_have_text("9: tension 800 N")
    page.keyboard.press("2")
    page.get_by_role("slider", name="frame").focus()
    page.keyboard.press("Home")
    expect(page.locator("#map-which")).to_have_text("0: calibration")
    page.keyboard.press("End")
    page.get_by_label("Show").select_option("displacement_v")
    expect(page.locator("#map-now")).to_contain_text("displacement v, corrected, frame 9: mean")
    page.locator("#map").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#map-now")).to_have_text(re.compile(r"^at \(\d+, \d+\) px: −?[\d.]+ ± [\d.]+ px \(−?[\d.]+ µm\); mean"))
    expect(page.get_by_role("img", name=re.compile("^Colours from .* px to .* px$"))).to_be_visible()
    expect(page.get_by_role("img", name=re.compile(r"6 frames under load; E is"))).to_be_visible()
    expect(page.locator("#frame-now")).to_contain_text("320 × 276 px, grid of 58 × 50 points")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    shoot(page, "tablet")


def test_a_person_enters_loads_on_the_page_and_a_limit_stops_all(
    bench: Callable[[str], Any], tab: Tab, shoot: Shoot, readable: Readable
) -> None:
    run = bench("by-hand")
    run.config["load_frame"] = {"driver": "operator", "settings": {"program": "MICROTEST"}}
    # A hold that nobody waits for, so that what is looked at in it is there for as long as it takes.
    run.config["protocol"].update(calibration_shifts_px=[], loads_n=[100.0], hold_s=3000.0)
    run.config["limits"]["force_max_n"] = 900.0
    page = tab(color_scheme="dark")
    page.goto(run.start())
    question = page.get_by_label("in MICROTEST, bring the load to 100 N")
    question.fill("ninety", timeout=60_000)
    page.keyboard.press("Enter")
    expect(page.locator("#told")).to_have_text("ninety is no load; type the load in N as MICROTEST shows it")
    question.fill("99,5")
    shoot(page, "question")
    page.get_by_role("button", name="Enter load").click()
    state(page, "holding")
    expect(page.locator("#desk")).to_be_hidden()
    expect(page.locator("#load-now")).to_contain_text("99.50 N of 100.0 N, stopped")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Resume").click()
    question.fill("950")
    page.keyboard.press("Enter")
    state(page, "FAULT")
    expect(page.get_by_role("alert")).to_contain_text("Check specimen and load frame")
    alarm = page.locator("#open-alarms")
    expect(alarm).to_contain_text("Alarm: ")
    shoot(page, "fault")
    readable(page)
    page.reload()
    expect(alarm).to_be_visible()
    page.get_by_role("button", name="Acknowledge", exact=True).click()
    expect(alarm).to_be_hidden()
    expect(page.locator("#alarms")).to_contain_text("page at 127.0.0.1")
    state(page, "FAULT")
    page.get_by_role("button", name="Stop").click()
    assert run.end() == 1
    assert run.logged("/state")[-1]["after"] == "aborted"
    (reported,) = [item["args"] for item in run.logged("/operator") if item["what"] == "acknowledge"]
    assert reported["by"] == "page at 127.0.0.1"
    with served(run.log) as shows:
        page.goto(shows)
        expect(page.locator("#alarms")).to_contain_text("page at 127.0.0.1")
        expect(page.get_by_role("button", name="Acknowledge", exact=True)).to_be_hidden()
