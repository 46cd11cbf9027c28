"""Every state at every size: what a person must know is there, large enough, on the screen, and nothing covers or cuts it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from semlive.engine import OperatorCommand

from .goldens import SIZES, compare, golden_page
from .staged_run import StagedRun, staged_run

# A laptop of 14 inches with 1366 px has pixels of 0.227 mm. Capitals of 12 mm at 4 m are 10 minutes of arc, twice the limit of the eye.
PIXEL_MM, CAPITAL_PART, MIN_CAPITAL_MM = 0.227, 0.72, 12.0
NEEDED = ("#state-word", "#left", "#modulus", "#lamp", "#stop")
LAYOUT = (Path(__file__).parent / "layout.js").read_text(encoding="utf-8")
SHOWN = {
    "starting": ("connecting", "", "–", "no result yet", "no alarm"),
    "ramp": ("moving", "", r"\d+ min", "70.4 ± 1.1 GPa", "no alarm"),
    "hold": ("holding", r"\d+ s left", r"\d+ min", "70.4 ± 1.1 GPa", "no alarm"),
    "imaging": ("imaging", "", r"\d+ min", "70.4 ± 1.1 GPa", "no alarm"),
    "paused": ("paused", "", r"\d+ min", "70.4 ± 1.1 GPa", "no alarm"),
    "question": ("question", "", r"\d+ min", "70.4 ± 1.1 GPa", "1 question"),
    "fault": ("FAULT", "", r"\d+ min", "70.4 ± 1.1 GPa", "1 ALARM"),
    "finished": ("complete", "", "none", "70.40 ± 0.64 GPa", "no alarm"),
}
"""What a person reads from the first view: state, countdown, time left, E with its uncertainty, and whether something is wrong."""
LOADS = {"ramp": "618.0 N", "hold": "799.6 N", "fault": "1207 N", "finished": "1100 N"}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StagedRun]:
    with staged_run(tmp_path_factory.mktemp("staged")) as staged:
        yield staged


def read(page: Page, state: str) -> None:
    word, countdown, left, modulus, lamp = SHOWN[state]
    expect(page.locator("#state-word")).to_have_text(word)
    for place, text in (("#countdown", countdown), ("#left", left), ("#modulus", re.escape(modulus)), ("#lamp-text", lamp)):
        expect(page.locator(place)).to_have_text(re.compile(f"^{text}$"))
    if state in LOADS:
        expect(page.locator("#load-value")).to_have_text(LOADS[state])
        expect(page.locator("#load-of")).to_contain_text("limit 1200 N")


def test_every_state_is_read_at_every_size(
    run: StagedRun, tab: Callable[..., Page], readable: Callable[[Page], None], tmp_path: Path, chromium_peer: Browser
) -> None:
    page = tab(viewport={"width": 1366, "height": 768})
    page.goto(run.address_with_token)
    not_operated = golden_page(chromium_peer, run.address_with_token)
    for state in SHOWN:
        run.show(state)
        read(page, state)
        for size, (width, height) in SIZES.items():
            page.set_viewport_size({"width": width, "height": height})
            assert page.evaluate(LAYOUT, list(NEEDED)) == [], (state, size)
            if size != "phone":
                scrolled = page.evaluate("[document.documentElement.scrollHeight, innerHeight]")
                assert scrolled[0] <= scrolled[1], (state, size)
                font_px = page.evaluate("parseFloat(getComputedStyle(document.getElementById('state-word')).fontSize)")
                assert font_px * CAPITAL_PART * PIXEL_MM >= MIN_CAPITAL_MM, (state, size)
            assert compare(not_operated, state, size) == ""
        if state in ("question", "fault"):
            readable(page)
        page.set_viewport_size({"width": 1366, "height": 768})
        if state == "hold":
            looked_at(page, run, readable, tmp_path)
            broken_pages_differ(not_operated)
        if state == "paused":
            left = page.locator("#left").text_content()
            expect(page.locator("#left-note")).to_have_text("stopped")
            page.wait_for_timeout(1500)
            assert page.locator("#left").text_content() == left
        if state == "fault":
            stopped_from_a_phone(run, tab)


def broken_pages_differ(page: Page) -> None:
    """A hidden panel, a moved button and a wrong colour do not look as the golden."""
    for broken in ("[data-area=next] { visibility: hidden }", "#stop { transform: translateX(-16px) }", ":root { --accent: #7a0b8f }"):
        page.evaluate(
            "(css) => { document.adoptedStyleSheets = [new CSSStyleSheet()]; document.adoptedStyleSheets[0].replaceSync(css) }", broken
        )
        assert "blocks differ" in compare(page, "hold", "laptop", patience_s=0.0), broken
    page.evaluate("document.adoptedStyleSheets = []")
    assert compare(page, "hold", "laptop") == ""


def looked_at(page: Page, run: StagedRun, readable: Callable[[Page], None], folder: Path) -> None:
    """The second and third view: measuring on the map, and files of what is shown."""
    page.keyboard.press("2")
    page.get_by_label("Show").select_option("mises")
    now, region = page.locator("#map-now"), page.locator("#region-now")
    expect(now).to_contain_text("von Mises strain, frame 7: mean")
    page.locator("#map").focus()
    page.keyboard.press("ArrowRight")
    expect(now).to_have_text(re.compile(r"^at \(330, 240\) px: \d+ ± \d+ 1e-6; mean \d+ 1e-6$"))
    page.get_by_role("button", name="line", exact=True).click()
    page.locator("#map").focus()
    page.keyboard.press("ArrowRight")
    expect(region).to_have_text(re.compile(r"von Mises strain from \(70, 240\) to \(580, 240\) px, 255 µm long"))
    expect(page.get_by_role("img", name=re.compile("255 µm long"))).to_be_visible()
    page.get_by_role("button", name="region", exact=True).click()
    page.locator("#map").focus()
    page.keyboard.press("Shift+ArrowUp")
    expect(region).to_have_text(re.compile(r"^\(60, 240\) to \(580, 230\) px: 106 valid, mean [\d.]+, median [\d.]+, standard deviation"))
    with page.expect_download() as download:
        page.get_by_role("button", name="Measure as CSV").click()
    download.value.save_as(folder / "region")
    assert "points,106\n" in (folder / "region").read_text(encoding="utf-8")
    page.get_by_label("Show").select_option("residual_v")
    expect(now).to_contain_text("residual v (difference within the pair), frame 7: mean")
    for kind, begins in (("CSV", b"x_px,y_px,residual_v_px,sigma\n60,60,,"), ("PNG", b"\x89PNG")):
        with page.expect_download() as download:
            page.get_by_role("button", name=f"Image with map as {kind}").click()
        path = folder / kind
        download.value.save_as(path)
        assert path.read_bytes().startswith(begins)
    with page.expect_download() as download:
        page.get_by_role("button", name="Stress and strain as CSV").click()
    assert download.value.suggested_filename == "al-5754-tension_stress.csv"
    assert page.evaluate(LAYOUT, list(NEEDED)) == []
    readable(page)
    with_its_own_image(page)
    page.keyboard.press("3")
    expect(page.locator("#log li").first).to_contain_text("→ holding")
    page.keyboard.press("d")
    assert page.evaluate(LAYOUT, list(NEEDED)) == []
    readable(page)
    page.keyboard.press("d")
    for opener in ("phone", "Keys"):
        page.get_by_role("button", name=opener, exact=True).click()
        # The stop button works while these dialogs are open.
        assert page.evaluate(LAYOUT, list(NEEDED)) == []
        page.get_by_role("button", name="Stop").click(trial=True)
    expect(page.locator("#qr-note")).to_contain_text("anyone who photographs it can control the run")
    assert page.locator("#qr").evaluate("(canvas) => canvas.width") > 25
    readable(page)
    page.keyboard.press("Escape")
    expect(page.locator("#qr")).to_be_hidden()
    page.keyboard.press("1")


def with_its_own_image(page: Page) -> None:
    """An earlier frame is shown with its own image and the mask at its place; the newest again with the newest image."""
    below, canvas = page.locator("#frame-now"), page.locator("#map")
    expect(below).to_contain_text("drawn at the points of frame 0")
    page.keyboard.press("[")
    expect(below).to_contain_text("image of frame 6, 640 × 480 px")
    expect(below).to_contain_text("frame 6, moved with the specimen")
    expect(canvas).to_have_attribute("aria-label", re.compile("^Image of frame 6, with the map: .*, frame 6"))
    shaded = canvas.evaluate("(map) => map.toDataURL()")
    page.get_by_label("shade the mask").uncheck()
    assert canvas.evaluate("(map) => map.toDataURL()") != shaded
    page.get_by_label("shade the mask").check()
    assert canvas.evaluate("(map) => map.toDataURL()") == shaded
    assert page.evaluate(LAYOUT, list(NEEDED)) == []
    page.keyboard.press("]")
    expect(below).to_contain_text("drawn at the points of frame 0")


def stopped_from_a_phone(run: StagedRun, tab: Callable[..., Any]) -> None:
    """The one stop button stays under the thumb at the end of the page, and its request is that of every other screen."""
    phone = tab(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    phone.goto(run.address_with_token)
    expect(phone.locator("#state-word")).to_have_text("FAULT")
    phone.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
    assert phone.evaluate(LAYOUT, ["#stop"]) == []
    with phone.expect_request("**/say") as request:
        phone.get_by_role("button", name="Stop").tap()
    assert (request.value.method, request.value.post_data) == ("POST", '{"say":"stop"}')
    assert request.value.headers["authorization"] == f"Bearer {run.control.token}"
    request.value.response()
    assert [verb for verb, _ in run.heard] == [OperatorCommand.STOP]
