"""Pictures of a report for the documentation: makes the page of a log, and photographs parts of it in Chromium.

    semlive demo --short --out /tmp/demo
    python tests/benchmarks/report_pictures.py /tmp/demo/log/demo --out docs/report

Writes ``summary.png``, ``protocol.png``, ``results.png`` and ``limits.png``, each with 256 colours.
"""

from __future__ import annotations

import argparse
import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

WIDTH_PX = 900
COLOURS = 256
PARTS = {
    "summary": ("#s1", "#s2 figure:last-of-type"),
    "protocol": ("#s3", "#protocol"),
    "results": ("#displacement-maps", "#strain-maps"),
    "limits": ("#s6", "#s7"),
}
"""First and last element of each picture."""


def photograph(page: Page, first: str, last: str) -> Image.Image:
    """The page from the top of one element to the bottom of another."""
    start, end = page.locator(first).bounding_box(), page.locator(last).bounding_box()
    if start is None or end is None:
        raise SystemExit(f"the page has no {first} or no {last}")
    clip = {"x": 0.0, "y": start["y"], "width": float(WIDTH_PX), "height": end["y"] + end["height"] - start["y"]}
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True, clip=clip)))  # type: ignore[arg-type]
    return picture.convert("RGB").quantize(COLOURS)


def main() -> int:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/report"))
    arguments = parser.parse_args()
    chromium = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if chromium is None:
        parser.error("no Chromium is installed")
    arguments.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        report = Path(folder) / "report.html"
        subprocess.run([sys.executable, "-m", "semlive", "report", str(arguments.log), "-o", str(report)], check=True)
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH_PX, "height": 900}, color_scheme="light")
        page.goto(report.as_uri())
        for name, (first, last) in PARTS.items():
            photograph(page, first, last).save(arguments.out / f"{name}.png", optimize=True)
        browser.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
