"""Golden pictures of the page: every state on a laptop, a large screen and a phone, as means of blocks of 8 px.

python tests/browser/goldens.py     # writes tests/browser/goldens/STATE-SIZE.png; look at the difference before committing

The pictures do not depend on the fonts of a computer: the page is drawn with DejaVu Sans of matplotlib. What changes with the time of the
run is masked. A block differs if it lies outside the range of the neighbours of its golden block by more than `TOLERANCE` in a colour, or
the other way round: letters that another version of the browser moves by a few pixels do not count, a missing one in white space does.
"""

from __future__ import annotations

import base64
import io
import shutil
import sys
import tempfile
import time
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

sys.path.insert(0, str(Path(__file__).parent))
from staged_run import STATES, StagedRun, staged_run

FOLDER = Path(__file__).parent / "goldens"
SIZES = {"laptop": (1366, 768), "large": (1920, 1080), "phone": (390, 844)}
BLOCK_PX, TOLERANCE = 8, 24
MOST_DIFFERENT = 16
"""Blocks. Measured differences are in decision 0072."""
MASKED = ("#countdown", "#left", "#left-note")
"""Texts that change from second to second; their places are compared."""
FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
FACES = (("100 599", "DejaVuSans.ttf"), ("600 900", "DejaVuSans-Bold.ttf"))
LOAD_FONT = """async (files) => {
    for (const [weight, text] of files) {
        const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
        document.fonts.add(await new FontFace("Golden", bytes, {weight}).load());
    }
    document.documentElement.style.fontFamily = "Golden";
    dispatchEvent(new Event("resize"));
}"""
Blocks = NDArray[np.float32]


def golden_page(browser: Browser, address: str) -> Page:
    """A page that nobody operates, with the font of the goldens."""
    page = browser.new_context(viewport={"width": 1366, "height": 768}, color_scheme="light").new_page()
    page.goto(address)
    page.evaluate(LOAD_FONT, [(weight, base64.b64encode((FONTS / name).read_bytes()).decode()) for weight, name in FACES])
    return page


def picture(page: Page, size: str) -> Image.Image:
    """What a screen of a size shows, 1 px for each block."""
    width, height = SIZES[size]
    page.set_viewport_size({"width": width, "height": height})
    masked = [page.locator(place) for place in MASKED]
    taken = Image.open(io.BytesIO(page.screenshot(mask=masked, type="jpeg", quality=95)))
    # A JPEG file contains the means of blocks of 8 px; they are read without decoding the rest.
    taken.draft("RGB", (width // BLOCK_PX, height // BLOCK_PX))
    return taken.convert("RGB")


def different(found: Image.Image, golden: Image.Image) -> NDArray[np.bool_]:
    """(rows, columns) whether a block differs."""
    one, other = (np.asarray(image, dtype=np.float32) for image in (found, golden))
    return _outside(one, other) | _outside(other, one)


def _outside(values: Blocks, around: Blocks) -> NDArray[np.bool_]:
    """Whether blocks are outside the range of a neighbourhood in another picture."""
    neighbours = np.ones((3, 3), dtype=np.uint8)
    low, high = cv2.erode(around, neighbours), cv2.dilate(around, neighbours)
    outside: NDArray[np.bool_] = (values < low - TOLERANCE) | (values > high + TOLERANCE)
    return np.any(outside, axis=2)


def compare(page: Page, state: str, size: str, patience_s: float = 15.0) -> str:
    """Nothing once the page looks as its golden; else, after a time, how many blocks differ and between which pixels."""
    golden = Image.open(FOLDER / f"{state}-{size}.png").convert("RGB")
    until = time.monotonic() + patience_s
    while True:
        wrong = different(picture(page, size), golden)
        if wrong.sum() <= MOST_DIFFERENT:
            return ""
        if time.monotonic() > until:
            y, x = (BLOCK_PX * place for place in np.nonzero(wrong))
            return f"{state}-{size}: {wrong.sum()} blocks differ in x {x.min()} to {x.max() + 8} px, y {y.min()} to {y.max() + 8} px"
        page.wait_for_timeout(100)


def write(browser: Browser, run: StagedRun) -> None:
    page = golden_page(browser, run.address_with_token)
    FOLDER.mkdir(exist_ok=True)
    for state in STATES:
        run.show(state)
        for size in SIZES:
            picture(page, size)
            page.wait_for_timeout(1500)
            picture(page, size).save(FOLDER / f"{state}-{size}.png", optimize=True)


if __name__ == "__main__":
    path = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as root, staged_run(Path(root)) as staged, sync_playwright() as playwright:
        write(playwright.chromium.launch(executable_path=path, args=["--no-sandbox"]), staged)
