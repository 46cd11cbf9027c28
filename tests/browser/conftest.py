"""Runs of the real daemon on a small bench, and a real Chromium that looks at their page."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import pytest
import yaml
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect, sync_playwright

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.service.log.files import messages

# A browser on two busy cores; where a page must be quick, its test states how quick.
expect.set_options(timeout=30_000)
# Every state text of the page, in order, however short it is shown: a test that samples the page misses some.
STATES = """addEventListener("DOMContentLoaded", () => {
    const shown = document.getElementById("state-word");
    window.states = [];
    if (shown) {
        const watched = {childList: true, characterData: true, subtree: true};
        new MutationObserver(() => window.states.push(shown.textContent)).observe(shown, watched);
    }
});"""
RATE = 30.0
SCENARIO = {
    "extends": "paper_x200",
    "scan": {"width_px": 320, "height_px": 276, "frame_time_s": 9.4},
    "export": {"databar_rows": 30},
    "detector": {"read_noise": 3.0, "shot_noise": 0.25},
    "experiment": {
        "protocol": {"calibration_shifts_px": [[0, 0], [12, 12]], "translation_shifts_px": [], "loads_n": [200, 500, 800]},
        "dic": {"subset_px": 31, "step_px": 5, "roi_px": None},
        "estimate": {"accept_poor_calibration": True},
    },
}


@dataclass
class Watched:
    """A run with its page."""

    folder: Path
    config: dict[str, Any]
    process: subprocess.Popen[str] | None = None
    printed: list[str] = field(default_factory=list)

    @property
    def log(self) -> Path:
        return self.folder / "log" / self.config["run"]["name"]

    def start(self, *options: str, port: int = 0) -> str:
        """The daemon with its page; gives the page's address with the token."""
        path = self.folder / "run.yaml"
        path.write_text(yaml.safe_dump(self.config), encoding="utf-8")
        command = [sys.executable, "-m", "semlive", "run", str(path), "--attended", "--page-port", str(port), *options]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.printed.append(line)
            if found := re.search(r"live page: (http\S+)", line):
                threading.Thread(target=self._collect, args=(self.process.stderr,), daemon=True).start()
                return found[1]
        raise AssertionError("".join(self.printed))

    def _collect(self, stream: IO[str]) -> None:
        with stream:
            self.printed.extend(stream)

    def logged(self, topic: str) -> list[dict[str, Any]]:
        return [json.loads(message.payload) for message in messages(self.log) if message.topic == topic]

    def end(self) -> int:
        assert self.process is not None
        return self.process.wait(150)

    def kill(self) -> None:
        """End a run that a failed test left; it would occupy the load frame of the next one."""
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], Watched]]:
    """Makes runs by name, all on one bench, which ends with the module: it renders three frames a second, used or not."""
    root, made = tmp_path_factory.mktemp("bench"), []
    scenario = root / "scenario.yaml"
    scenario.write_text(yaml.safe_dump(SCENARIO), encoding="utf-8")
    with running_simulator(str(scenario), root / "bench", RATE) as ready:

        def make(name: str) -> Watched:
            for item in made:
                item.kill()
            config = daemon_config(ready, RATE)
            config["run"]["name"] = name
            config["protocol"]["load_tolerance_n"] = 20.0
            # A browser on two busy cores is no reason to call the links lost.
            config["limits"].update(stale_after_s=5.0, lost_after_s=20.0)
            made.append(Watched(root / name, json.loads(json.dumps(config))))
            made[-1].folder.mkdir()
            return made[-1]

        yield make
        for item in made:
            item.kill()


@pytest.fixture(scope="module")
def chromium_peer() -> Iterator[Browser]:
    """The system's own Chromium; while it is there this thread has an event loop, so not longer than a module's tests."""
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no Chromium is installed")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def tab(chromium_peer: Browser) -> Iterator[Callable[..., Page]]:
    """Opens pages of browsers that know nothing of each other; an error in a page fails the test."""
    contexts, errors = [], []

    def opened(**how: Any) -> Page:
        context = chromium_peer.new_context(**{"viewport": {"width": 1440, "height": 900}, **how})
        context.add_init_script(STATES)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        return page

    yield opened
    for context in contexts:
        context.close()
    assert not errors


@pytest.fixture
def shoot(tmp_path: Path) -> Callable[[Page, str], None]:
    """Takes a picture of a page; SEMLIVE_SCREENSHOTS names a folder to keep them."""
    folder = Path(os.environ.get("SEMLIVE_SCREENSHOTS", tmp_path))

    def take(page: Page, name: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=folder / f"{name}.png", full_page=True)

    return take


@pytest.fixture
def readable() -> Callable[[Page], None]:
    """Check by axe-core that a page can be used with a screen reader and without colours."""

    def check(page: Page) -> None:
        found = Axe().run(page)
        assert not found.response["violations"], found.generate_report()

    return check
