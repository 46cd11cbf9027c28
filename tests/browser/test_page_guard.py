"""Who is let in: the token, the page's own origin, known names, small requests; everybody else may look, and nothing more."""

from __future__ import annotations

import asyncio
import http.client
import http.server
import json
import queue
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.engine import OperatorCommand
from semlive.formats.log.maps import encode_map
from semlive.formats.log.messages import DIC_MAP, SEM_ORIGINAL, FaultMessage, FileMessage, OperatorMessage, RunMessage, StateMessage
from semlive.service.control.socket import ControlSocket, SocketAddress, token_digest
from semlive.service.log.files import segment_path
from semlive.service.log.recording import Recorder
from semlive.service.runtime.clock import SystemClock


@dataclass
class Run:
    """A log that grows and a door that notes what it hears, with a page over both."""

    port: int
    control: SocketAddress
    recorder: Recorder
    clock: SystemClock
    heard: list[tuple[OperatorCommand | str, str]] = field(default_factory=list)

    def ask(self, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, str]:
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            line.request(method, path, body or None, {name.replace("_", "-"): value for name, value in headers.items()})
            reply = line.getresponse()
            return reply.status, reply.read(10_000).decode(errors="replace")
        finally:
            line.close()

    def say(self, body: Any, **headers: str) -> tuple[int, str]:
        own = {
            "origin": f"http://127.0.0.1:{self.port}",
            "content_type": "application/json",
            "authorization": f"Bearer {self.control.token}",
        }
        return self.ask("POST", "/say", json.dumps(body).encode(), **{**own, **headers})

    def export(self, number: int, name: str) -> None:
        """A file that nobody can read arrives."""
        told = FileMessage(export=number, name=name, size=4, sha256="", mtime_ns=0, arrival_time_ns=0, decision="arrived", reason="")
        self.recorder.write(SEM_ORIGINAL, b"none", sequence=number)
        self.recorder.write("/sem/file", told)
        self.recorder.flush()

    def enter(self, state: str) -> None:
        now_ns = self.clock.now_ns()
        self.recorder.write("/state", StateMessage(time_ns=now_ns, before="idle", after=state, cause="start", step=0, guards={}))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    folder = tmp_path_factory.mktemp("run")
    heard: list[tuple[OperatorCommand | str, str]] = []
    opened: queue.Queue[tuple[SocketAddress, Callable[[], object]]] = queue.Queue()
    listening = threading.Thread(target=lambda: asyncio.run(listen(heard, opened.put)))
    listening.start()
    control, leave = opened.get(timeout=60)
    clock = SystemClock()
    recorder = Recorder(segment_path(folder, "run", 0), clock, lambda _: None)
    recorder.write("/run", RunMessage(run="run", started_time_ns=clock.now_ns(), host="lab", versions={}, config={}))
    process = page_of(folder, "--control", str(control.port), "--token-sha256", token_digest(control.token))
    assert process.stdout is not None
    one = Run(int(process.stdout.readline()), control, recorder, clock, heard)
    one.enter("holding")
    yield one
    process.communicate()
    recorder.close()
    leave()
    listening.join()


async def listen(
    heard: list[tuple[OperatorCommand | str, str]], opened: Callable[[tuple[SocketAddress, Callable[[], object]]], object]
) -> None:
    """A door, until it is left."""
    door = ControlSocket(
        lambda verb, by: heard.append((verb, by)),
        lambda question, line: (question, line) == ("terminal.1", "5"),
        lambda alarm, by: alarm != "6" and not heard.append((alarm, by)),
    )
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    opened((await door.open(), lambda: loop.call_soon_threadsafe(over.set)))
    await over.wait()
    door.close()


def page_of(folder: Path, *options: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "semlive.web", str(folder), "--host", "127.0.0.1", "--port", "0", "--exit-with-stdin", *options]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def test_the_page_and_the_token_steer(run: Run) -> None:
    assert run.say({"say": "pause"})[0] == 200
    assert run.heard.pop() == (OperatorCommand.PAUSE, "page at 127.0.0.1")
    assert run.say({"question": "terminal.1", "answer": "5"})[0] == 200
    assert run.say({"acknowledge": "5"})[0] == 200
    assert run.heard.pop() == ("5", "page at 127.0.0.1")
    assert run.say({"acknowledge": "6"}) == (409, '{"text":"this alarm is acknowledged already, or unknown"}')
    assert run.say({"question": "terminal.2", "answer": "5"}) == (409, '{"text":"this question is not open any more"}')


@pytest.mark.parametrize(
    ("status", "body", "headers"),
    [
        (403, {"say": "abort"}, {"authorization": "Bearer wrong"}),
        (403, {"say": "abort"}, {"authorization": ""}),
        (403, {"say": "abort"}, {"authorization": "Basic {token}"}),
        (403, {"say": "abort"}, {"origin": "http://evil.example"}),
        (403, {"say": "abort"}, {"origin": "null"}),
        (403, {"say": "abort"}, {"origin": "http://127.0.0.1:1"}),
        (421, {"say": "abort"}, {"host": "evil.example", "origin": "http://evil.example"}),
        (415, {"say": "abort"}, {"content_type": "text/plain"}),
        (413, {"say": "abort", "by": "x" * 5000}, {}),
        (411, {"say": "abort"}, {"transfer_encoding": "chunked", "content_length": ""}),
        (400, {"say": "abort", "question": "terminal.1"}, {}),
        (400, {"say": "jump"}, {}),
        (400, {"say": "abort", "acknowledge": "5"}, {}),
        (400, {"acknowledge": "all"}, {}),
        (400, {"say": "abort", "token": 5, "more": 1}, {}),
        (400, ["abort"], {}),
        (400, {"question": "terminal.1", "answer": "5\n6"}, {}),
    ],
)
def test_everybody_else_changes_nothing(run: Run, status: int, body: Any, headers: dict[str, str]) -> None:
    given = {name: value.format(token=run.control.token) for name, value in headers.items()}
    if "transfer_encoding" in given:
        del given["content_length"]
    assert run.say(body, **given)[0] == status
    assert not run.heard


def test_looking_needs_no_token_but_a_name_of_this_computer(run: Run) -> None:
    assert run.ask("GET", "/")[0] == 200
    assert run.ask("GET", "/", host=f"localhost:{run.port}")[0] == 200
    assert run.ask("GET", "/", host=f"192.168.0.7:{run.port}")[0] == 200
    assert run.ask("GET", "/", host=f"[::1]:{run.port}")[0] == 200
    assert run.ask("GET", "/", host="evil.example")[0] == 421
    for path in (
        "/say",
        "/field/0/eyy",
        "/frame/0.png",
        "/static/../app.py",
        "/static/%2e%2e/app.py",
        "/field/0/..%2f..%2fx",
        "/../app.py",
    ):
        assert run.ask("GET", path)[0] in (404, 405), path


def test_a_page_that_only_shows_passes_nothing_on(run: Run) -> None:
    process = page_of(run.recorder.path.parent)
    assert process.stdout is not None
    shows = Run(int(process.stdout.readline()), run.control, run.recorder, run.clock)
    assert shows.ask("GET", "/about") == (200, '{"controls":false}')
    assert shows.say({"say": "abort"})[0] == 405
    process.communicate()
    assert not run.heard


def test_in_a_browser_another_s_page_neither_reads_nor_steers(run: Run, tab: Callable[..., Page]) -> None:
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), http.server.SimpleHTTPRequestHandler) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        page = tab()
        page.goto(f"http://127.0.0.1:{other.server_address[1]}/")
        tried = page.evaluate(
            """async ([port, token]) => {
                const address = `http://127.0.0.1:${port}`;
                const headers = {"content-type": "application/json", authorization: `Bearer ${token}`};
                const body = '{"say": "abort"}';
                const blocked = (asked) => asked.then(() => "let through", () => "blocked");
                return [
                    await blocked(fetch(`${address}/say`, {method: "POST", headers, body})),
                    await blocked(fetch(`${address}/say`, {method: "POST", mode: "no-cors", body})),
                    await blocked(fetch(`${address}/about`)),
                    await new Promise((done) => {
                        const news = new EventSource(`${address}/events`);
                        news.onmessage = () => done("let through");
                        news.onerror = () => done("blocked");
                    }),
                ];
            }""",
            [run.port, run.control.token],
        )
        other.shutdown()
    assert tried == ["blocked"] * 4
    assert not run.heard


def test_a_wrong_token_is_told_so_and_forgotten(run: Run, tab: Callable[..., Page]) -> None:
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/#token=wrong")
    expect(page.locator("#state-word")).to_have_text("holding")
    page.get_by_role("button", name="Pause").click()
    expect(page.locator("#answer")).to_contain_text("the token is not that of this run")
    page.get_by_role("button", name="Stop").click()
    expect(page.get_by_role("dialog", name="Token")).to_be_visible()
    page.keyboard.press("Escape")
    assert not run.heard


def test_abort_asks_and_keys_are_enough(run: Run, tab: Callable[..., Page]) -> None:
    page = tab(viewport={"width": 820, "height": 1180}, has_touch=True)
    page.goto(f"http://127.0.0.1:{run.port}/#token={run.control.token}")
    expect(page.locator("#state-word")).to_have_text("holding")
    for _ in range(3):
        page.keyboard.press("Tab")
    expect(page.get_by_role("button", name="Abort…")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Continue")).to_be_focused()
    page.keyboard.press("Enter")
    assert not run.heard
    page.keyboard.press("Enter")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.locator("#ask-abort")).to_be_hidden()
    for _ in range(300):
        if run.heard:
            break
        page.wait_for_timeout(100)
    assert [verb for verb, _ in run.heard] == [OperatorCommand.ABORT]
    run.heard.clear()


def test_an_abort_is_heard_however_quickly_the_question_was_asked_before(run: Run, tab: Callable[..., Page]) -> None:
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/#token={run.control.token}")
    expect(page.locator("#state-word")).to_have_text("holding")
    with page.expect_response("**/say"):
        page.evaluate(
            """() => {
                for (const value of ["no", "yes"]) {
                    document.querySelector("[data-say=abort]").click();
                    document.querySelector(`#ask-abort button[value=${value}]`).click();
                }
            }"""
        )
    assert [verb for verb, _ in run.heard] == [OperatorCommand.ABORT]
    run.heard.clear()


def test_a_token_is_for_what_was_asked_last_however_quickly_it_was_asked_for_before(run: Run, tab: Callable[..., Page]) -> None:
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/")
    expect(page.locator("#state-word")).to_have_text("holding")
    with page.expect_response("**/say"):
        page.evaluate(
            """(token) => {
                document.querySelector("[data-say=pause]").click();
                document.getElementById("ask-token").close();
                document.querySelector("[data-say=stop]").click();
                document.getElementById("token-text").value = token;
                document.querySelector("#ask-token button[value=keep]").click();
            }""",
            run.control.token,
        )
    assert [verb for verb, _ in run.heard] == [OperatorCommand.STOP]
    run.heard.clear()


def test_enter_keeps_a_token(run: Run, tab: Callable[..., Page]) -> None:
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/")
    expect(page.locator("#state-word")).to_have_text("holding")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("textbox", name="Token").fill(run.control.token)
    with page.expect_response("**/say"):
        page.keyboard.press("Enter")
    assert [verb for verb, _ in run.heard] == [OperatorCommand.PAUSE]
    run.heard.clear()


def test_the_refusal_of_an_old_token_does_not_take_the_new_one_away(run: Run, tab: Callable[..., Page]) -> None:
    page, held = tab(), []
    page.goto(f"http://127.0.0.1:{run.port}/#token=wrong")
    expect(page.locator("#state-word")).to_have_text("holding")
    page.route("**/say", lambda route: held.append(route), times=1)
    with page.expect_request("**/say"):
        page.get_by_role("button", name="Pause").click()
    page.evaluate("(token) => { location.hash = `#token=${token}`; }", run.control.token)
    expect(page).to_have_url(f"http://127.0.0.1:{run.port}/")
    held[0].continue_()
    expect(page.locator("#answer")).to_contain_text("the token is not that of this run")
    with page.expect_response("**/say"):
        page.get_by_role("button", name="Pause").click()
    assert [verb for verb, _ in run.heard] == [OperatorCommand.PAUSE]
    run.heard.clear()


def test_a_map_on_its_way_lends_its_name_and_unit_to_no_other(run: Run, tab: Callable[..., Page]) -> None:
    half, ones = np.full((3, 4), 0.5), np.ones((3, 4))
    ready = np.full((3, 4), PoiStatus.CONVERGED, dtype=np.uint8)
    run.recorder.write(DIC_MAP, encode_map(DisparityMap(0, 1, Grid(10, 10, 5, 4, 3, 21), half, half, half, half, ones, ready)))
    run.recorder.flush()
    page, held = tab(), []
    page.goto(f"http://127.0.0.1:{run.port}/")
    told = page.locator("#map-now")
    expect(told).to_contain_text("disparity u, as measured, frame 1: mean 0.500 px")
    page.route("**/zncc*", lambda route: held.append(route))
    with page.expect_request("**/zncc*"):
        page.get_by_label("Show").select_option("zncc")
    page.locator("#map").focus()
    page.keyboard.press("ArrowRight")
    expect(told).to_contain_text("0.5000 px; mean 0.500 px")
    held[0].continue_()
    expect(told).to_contain_text(": 1.000 ; mean 1.00")


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
    asked = {"text": "in MICROTEST, bring the load to 100 N", "question": "terminal.1", "wanted": "load_n"}
    run.recorder.write("/operator", OperatorMessage(time_ns=run.clock.now_ns(), what="asked", args=asked))
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


def test_readers_of_screens_are_told_of_a_map_on_its_way(run: Run, tab: Callable[..., Page], readable: Callable[[Page], None]) -> None:
    half, ones = np.full((3, 4), 0.5), np.ones((3, 4))
    ready = np.full((3, 4), PoiStatus.CONVERGED, dtype=np.uint8)
    run.recorder.write(DIC_MAP, encode_map(DisparityMap(0, 1, Grid(10, 10, 5, 4, 3, 21), half, half, half, half, ones, ready)))
    run.recorder.flush()
    page, held = tab(), []
    page.route("**/field/**", lambda route: held.append(route))
    with page.expect_request("**/field/**"):
        page.goto(f"http://127.0.0.1:{run.port}/")
    expect(page.locator("#map")).to_be_visible()
    readable(page)
    held[0].continue_()
    expect(page.locator("#map-now")).to_contain_text("mean 0.500 px")
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


def test_a_page_sees_a_transition_at_once(run: Run, tab: Callable[..., Page]) -> None:
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/")
    for state, word in (("imaging", "imaging"), ("fault", "FAULT"), ("complete", "complete")):
        run.enter(state)
        expect(page.locator("#state-word")).to_have_text(word, timeout=5_000)
