"""Screenshots of the documentation: every state of the page, on a laptop, a large screen and a phone.

python tests/browser/screenshots.py [docs/live-page] [--all]     # --all: every state at every size
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

sys.path.insert(0, str(Path(__file__).parent))
from staged_run import STATES, StagedRun, staged_run

ROOT = Path(__file__).resolve().parents[2]
SIZES = {"1366": (1366, 768), "1920": (1920, 1080), "phone": (390, 844)}
SHOWN = {"hold": ("1366", "1920", "phone"), "fault": ("1366", "phone")}
COLOURS = 256


def shoot(page: Page, folder: Path, name: str) -> None:
    """Store a picture; those without a large map with a palette, which takes a third of the bytes."""
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    stored = picture if name == "see" else picture.quantize(COLOURS, dither=Image.Dither.NONE)
    stored.save(folder / f"{name}.png", optimize=True)


def opened(browser: Browser, run: StagedRun, size: str, scheme: str = "light") -> Page:
    width, height = SIZES[size]
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page = context.new_page()
    page.goto(run.address_with_token)
    return page


def take(folder: Path, everything: bool) -> None:
    path = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as root, staged_run(Path(root)) as run, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        pages = {size: opened(browser, run, size) for size in SIZES}
        for state in STATES:
            run.show(state)
            pages["1366"].wait_for_timeout(3000)
            for size, page in pages.items():
                if everything or size in SHOWN.get(state, ("1366",)):
                    shoot(page, folder, f"{state}-{size}")
            if state == "hold":
                for size, scheme in (("1366", "light"), ("1366", "dark")):
                    page = opened(browser, run, size, scheme)
                    page.wait_for_timeout(3000)
                    if scheme == "dark":
                        shoot(page, folder, "dark")
                        continue
                    views(page, folder)
        browser.close()


def views(page: Page, folder: Path) -> None:
    """The second and third view: a line profile over the map, and the checks."""
    page.get_by_role("button", name="See", exact=True).click()
    page.get_by_role("button", name="line", exact=True).click()
    page.wait_for_timeout(500)
    box = page.locator("#map").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 0.5 * box["height"], steps=4)
    page.mouse.up()
    page.wait_for_timeout(500)
    shoot(page, folder, "see")
    page.get_by_role("button", name="Check", exact=True).click()
    page.wait_for_timeout(500)
    shoot(page, folder, "check")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Screenshots of the live page.")
    parser.add_argument("folder", type=Path, nargs="?", default=ROOT / "docs" / "live-page")
    parser.add_argument("--all", action="store_true")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    take(arguments.folder, arguments.all)
