"""The page in a browser: order of late replies, screen readers and alarms."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page, expect

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.data.loading import MotionState
from semlive.formats.log.maps import encode_map
from semlive.formats.log.messages import DIC_MAP, FaultMessage, LoadSampleMessage, OperatorMessage

from .guarded_run import Run, guarded_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with guarded_run(tmp_path_factory.mktemp("run")) as guarded:
        yield guarded


def test_a_map_on_its_way_lends_its_name_and_unit_to_no_other(run: Run, tab: Callable[..., Page]) -> None:
    half, ones = np.full((3, 4), 0.5), np.ones((3, 4))
    ready = np.full((3, 4), PoiStatus.CONVERGED, dtype=np.uint8)
    run.recorder.write(DIC_MAP, encode_map(DisparityMap(0, 1, Grid(10, 10, 5, 4, 3, 21), half, half, half, half, ones, ready)))
    run.recorder.flush()
    page, held = tab(), []
    page.goto(f"http://127.0.0.1:{run.port}/")
    reported = page.locator("#map-now")
    expect(reported).to_contain_text("disparity u, as measured, frame 1: mean 0.500 px")
    page.keyboard.press("2")
    page.route("**/zncc*", lambda route: held.append(route))
    with page.expect_request("**/zncc*"):
        page.get_by_label("Show").select_option("zncc")
    page.locator("#map").focus()
    page.keyboard.press("ArrowRight")
    expect(reported).to_contain_text("0.50 ± 0.50 px; mean 0.500 px")
    held[0].continue_()
    expect(reported).to_contain_text(": 1.000; mean 1.00")


def test_the_newest_frame_is_shown_though_it_came_while_another_was_fetched(run: Run, tab: Callable[..., Page]) -> None:
    page, held = tab(), []
    page.goto(f"http://127.0.0.1:{run.port}/")
    page.route("**/frame/1.png", lambda route: held.append(route))
    with page.expect_request("**/frame/1.png"):
        run.export(1, "first.tif")
    run.export(2, "second.tif")
    expect(page.locator("#refused-now")).to_contain_text("2 files arrived")
    held[0].continue_()
    expect(page.locator("#frame-now")).to_contain_text("second.tif")


def test_readers_of_screens_find_their_way(run: Run, tab: Callable[..., Page], readable: Callable[[Page], None]) -> None:
    requests = {"text": "in MICROTEST, bring the load to 100 N", "question": "terminal.1", "wanted": "load_n"}
    run.recorder.write("/operator", OperatorMessage(time_ns=run.clock.now_ns(), what="asked", args=requests))
    run.enter("paused")
    for scheme in ("light", "dark"):
        page = tab(color_scheme=scheme)
        page.goto(f"http://127.0.0.1:{run.port}/")
        expect(page.get_by_role("alert")).to_contain_text("paused")
        expect(page.get_by_label("in MICROTEST, bring the load to 100 N")).to_be_visible()
        readable(page)
        for opener in ("Abort…", "Token…"):
            page.get_by_role("button", name=opener).click()
            readable(page)
            page.keyboard.press("Escape")


def test_screen_readers_get_a_status_while_a_map_loads(run: Run, tab: Callable[..., Page], readable: Callable[[Page], None]) -> None:
    half, ones = np.full((3, 4), 0.5), np.ones((3, 4))
    ready = np.full((3, 4), PoiStatus.CONVERGED, dtype=np.uint8)
    run.recorder.write(DIC_MAP, encode_map(DisparityMap(0, 1, Grid(10, 10, 5, 4, 3, 21), half, half, half, half, ones, ready)))
    run.recorder.flush()
    page, held, maps = tab(), [], []
    page.on("request", lambda request: maps.append(request.url) if "/field/" in request.url else None)
    page.route("**/disparity_u*", lambda route: held.append(route))
    with page.expect_request("**/disparity_u*"):
        page.goto(f"http://127.0.0.1:{run.port}/")
    expect(page.locator("#map")).to_be_visible()
    readable(page)
    # One map at a time, so that a connection is free for Stop.
    assert len(maps) == 1
    held[0].continue_()
    expect(page.locator("#map-now")).to_contain_text("mean 0.500 px")
    assert len(maps) == 2
    readable(page)


def raised(run: Run, code: str, what: str) -> str:
    """An alarm is written; gives its identity."""
    now_ns = run.clock.now_ns()
    run.recorder.write("/fault", FaultMessage(time_ns=now_ns, what=what, where="load frame", action="stopped", code=code))
    run.recorder.flush()
    return str(now_ns)


def acknowledged(run: Run, identity: str) -> None:
    """The run has taken an acknowledgement, and writes it down."""
    assert run.heard.pop() == (identity, "page at 127.0.0.1")
    args = {"alarm": identity, "by": "page at 127.0.0.1"}
    run.recorder.write("/operator", OperatorMessage(time_ns=run.clock.now_ns(), what="acknowledge", args=args))
    run.recorder.flush()


def test_an_alarm_is_shown_to_everybody_until_it_is_acknowledged(
    run: Run, tab: Callable[..., Page], readable: Callable[[Page], None]
) -> None:
    first, second = raised(run, "limit", "the load is beyond its limit"), raised(run, "stop_not_obeyed", "it moves on after 12 stops")
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/#token={run.control.token}")
    banner, bar, listed = page.locator("#disobeyed"), page.locator("#open-alarms"), page.locator("#alarms li")
    for _ in range(2):
        expect(banner).to_contain_text("press the machine's own emergency stop now")
        expect(bar).to_contain_text("Alarm, one of 2 not acknowledged: ")
        expect(listed.first).to_contain_text("stop_not_obeyed")
        readable(page)
        page.reload()
    with page.expect_response("**/say"):
        page.get_by_role("button", name="Acknowledge", exact=True).click()
    expect(banner).to_be_visible()
    acknowledged(run, second)
    expect(banner).to_be_hidden()
    expect(bar).to_contain_text("the load is beyond its limit")
    with page.expect_response("**/say"):
        page.get_by_role("button", name="Acknowledge", exact=True).click()
    acknowledged(run, first)
    expect(bar).to_be_hidden()
    expect(listed.first).to_contain_text("page at 127.0.0.1")
    assert not run.heard


def test_a_warning_about_a_result_does_not_cover_an_alarm_that_needs_a_person(
    run: Run, tab: Callable[..., Page], readable: Callable[[Page], None]
) -> None:
    limit = raised(run, "limit", "the load is beyond its limit")
    now_ns = run.clock.now_ns()
    note = FaultMessage(time_ns=now_ns, what="the residual is not white", where="estimate with pair 4", action="the run continues")
    run.recorder.write("/fault", note)
    run.recorder.flush()
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/#token={run.control.token}")
    bar = page.locator("#open-alarms")
    expect(bar).to_contain_text("Alarm, one of 2 not acknowledged: ")
    expect(bar).to_contain_text("the load is beyond its limit")
    expect(bar).not_to_have_class(re.compile("warn"))
    for identity in (limit, str(now_ns)):
        with page.expect_response("**/say"):
            page.get_by_role("button", name="Acknowledge", exact=True).click()
        acknowledged(run, identity)
        if identity == limit:
            expect(bar).to_contain_text("To be checked: ")
            expect(bar).to_have_class(re.compile("warn"))
            readable(page)
    expect(bar).to_be_hidden()


def test_a_transition_appears_at_once(run: Run, tab: Callable[..., Page]) -> None:
    """With an open question too: it never replaces a fault."""
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/")
    for state, word in (("imaging", "imaging"), ("fault", "FAULT"), ("complete", "complete")):
        run.enter(state)
        expect(page.locator("#state-word")).to_have_text(word, timeout=5_000)


def test_no_axis_degenerates(run: Run, tab: Callable[..., Page]) -> None:
    """Ranges of equal, rounded and missing values have a width, and neighbouring numbers of an axis differ."""
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/")
    found = page.evaluate(
        """async () => {
            const {atLeast, ticks} = await import("/static/chart.js");
            const infinite = [Infinity, -Infinity], missing = [null, null];
            const values = [[0, 0], [5, 5], [1e-13, 3e-13], [70, 70 + 1e-12], [-3e6, -3e6], [1e-9, 1e-9], missing, infinite];
            return values.map(([low, high]) => {
                const [from, to] = atLeast(undefined, 1.1)(null, low, high);
                return [to - from, ticks(null, [0, 1, 2, 3].map((at) => from + (at * (to - from)) / 3))];
            });
        }"""
    )
    drawn = page.evaluate(
        """async () => {
            const {ticks} = await import("/static/chart.js");
            return [[0, 2.5, 5, 7.5], [0.925, 0.95, 0.975, 1], [0, 20, 40], [-0.5, 0, 0.5]].map((splits) => ticks(null, splits));
        }"""
    )
    assert drawn == [["0.0", "2.5", "5.0", "7.5"], ["0.925", "0.950", "0.975", "1.000"], ["0", "20", "40"], ["\u22120.5", "0.0", "0.5"]]
    for width, numbers in found:
        assert width > 0.0
        assert len(set(numbers)) == 4, numbers
        assert max(map(len, numbers)) <= 12, numbers


def test_an_extension_that_no_machine_measures_is_not_drawn(run: Run, tab: Callable[..., Page]) -> None:
    page, now_ns = tab(), run.clock.now_ns()
    page.goto(f"http://127.0.0.1:{run.port}/")
    for number, extension_mm in enumerate((0.0, 0.0, 0.2)):
        sample = LoadSampleMessage(
            sequence=number,
            time_ns=now_ns,
            mono_ns=0,
            force_n=5.0,
            extension_mm=extension_mm,
            motion=MotionState.STOPPED,
            target_n=5.0,
            raw=(),
        )
        run.recorder.write("/load_frame/sample", sample, now_ns + 10**9 * number)
        run.recorder.flush()
        measured = extension_mm != 0.0
        expect(page.locator("#h-load")).to_have_text("Load and extension" if measured else "Load")
        expect(
            page.get_by_role("img", name=re.compile("^Load and extension over" if measured else "^Load over time: 5.000 N"))
        ).to_be_visible()
        expect(page.locator("#load .key")).to_have_text(re.compile("^extension mm" if measured else "^target N"))


def test_maps_and_measurements_are_computed_as_defined(run: Run, tab: Callable[..., Page]) -> None:
    """Against eigenvalues and statistics of numpy, and an uncertainty from random draws."""
    draw = np.random.default_rng(3)
    parts, sigmas = draw.normal(0.0, 1e-3, 3), np.array([9e-5, 8e-5, 6e-5])
    field = draw.normal(size=(5, 7))
    field[1, 2] = np.nan
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/")
    found = page.evaluate(
        """async ([parts, sigmas, values]) => {
            const {FIELDS, strainSigma} = await import("/static/fields.js");
            const {profile, roundLength, statistics} = await import("/static/regions.js");
            const single = parts.map((value) => new Float32Array([value]));
            const named = ["e1", "e2", "shear", "mises"];
            values = values.map((value) => value ?? NaN);
            return {
                values: named.map((name) => FIELDS[name].values(single)[0]), sigmas: named.map((name) => strainSigma(name, parts, sigmas)),
                statistics: statistics(values), line: profile(values, 7, 5, [0, 4], [6, 4]).map(([, value]) => value),
                lengths: [0.37, 1, 70].map(roundLength),
            };
        }""",
        [parts.tolist(), sigmas.tolist(), [None if np.isnan(value) else value for value in field.ravel().tolist()]],
    )

    def invariants(e: NDArray[np.float64]) -> NDArray[np.float64]:
        small, large = np.linalg.eigvalsh(np.moveaxis(np.array([[e[0], e[2]], [e[2], e[1]]]), -1, 0)).T
        return np.array([large, small, large - small, np.sqrt(large**2 - large * small + small**2)])

    assert found["values"] == pytest.approx(invariants(parts[:, None])[:, 0], rel=1e-5)
    drawn = invariants(draw.normal(parts[:, None], 0.2 * sigmas[:, None], (3, 20_000)))
    assert found["sigmas"] == pytest.approx(5.0 * drawn.std(axis=1), rel=0.05)
    valid = field[np.isfinite(field)]
    expected = {
        "points": 34,
        "mean": valid.mean(),
        "sd": valid.std(ddof=1),
        "median": np.median(valid),
        "low": valid.min(),
        "high": valid.max(),
    }
    assert found["statistics"] == pytest.approx(expected)
    assert found["line"] == pytest.approx(field[4])
    assert found["lengths"] == [0.2, 1, 50]
