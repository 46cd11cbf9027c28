"""Who is let in: the token, the page's own origin, known names, small requests; everybody else may look, and nothing more."""

from __future__ import annotations

import http.client
import http.server
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from semlive.engine import OperatorCommand

from .guarded_run import Run, guarded_run, page_of


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with guarded_run(tmp_path_factory.mktemp("run")) as guarded:
        yield guarded


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


def test_a_wrong_token_is_rejected_and_forgotten(run: Run, tab: Callable[..., Page]) -> None:
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


def test_abort_is_accepted_immediately_after_its_confirmation_appeared(run: Run, tab: Callable[..., Page]) -> None:
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


def test_a_token_belongs_to_the_last_request_after_fast_requests(run: Run, tab: Callable[..., Page]) -> None:
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


@pytest.mark.parametrize("opener", ["Abort…", "Token…", "phone", "Keys"])
def test_stop_is_reached_by_the_mouse_while_a_dialog_is_open(run: Run, tab: Callable[..., Page], opener: str) -> None:
    page = tab(viewport={"width": 1366, "height": 768})
    page.goto(f"http://127.0.0.1:{run.port}/#token={run.control.token}")
    expect(page.locator("#state-word")).to_have_text("holding")
    page.get_by_role("button", name=opener, exact=True).click()
    expect(page.locator("dialog[open]")).to_have_count(1)
    with page.expect_response("**/say"):
        page.get_by_role("button", name="Stop").click()
    assert [verb for verb, _ in run.heard] == [OperatorCommand.STOP]
    run.heard.clear()


@pytest.mark.parametrize("opener", ["Abort…", "Token…"])
def test_stop_is_reached_by_the_keyboard_while_a_dialog_is_open(run: Run, tab: Callable[..., Page], opener: str) -> None:
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/#token={run.control.token}")
    expect(page.locator("#state-word")).to_have_text("holding")
    page.get_by_role("button", name=opener, exact=True).press("Enter")
    # After the dialog, the last element of the page, Tab continues at its first element.
    for _ in range(12):
        page.keyboard.press("Tab")
        if page.get_by_role("button", name="Stop").evaluate("(button) => button === document.activeElement"):
            break
    expect(page.locator("dialog[open]")).to_have_count(1)
    with page.expect_response("**/say"):
        page.keyboard.press("Enter")
    assert [verb for verb, _ in run.heard] == [OperatorCommand.STOP]
    run.heard.clear()


@pytest.mark.parametrize("opener", ["Abort…", "Token…"])
def test_stop_is_reached_by_the_thumb_while_a_dialog_is_open(run: Run, tab: Callable[..., Page], opener: str) -> None:
    page = tab(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page.goto(f"http://127.0.0.1:{run.port}/#token={run.control.token}")
    expect(page.locator("#state-word")).to_have_text("holding")
    page.get_by_role("button", name=opener, exact=True).tap()
    expect(page.locator("dialog[open]")).to_have_count(1)
    with page.expect_response("**/say"):
        page.get_by_role("button", name="Stop").tap()
    assert [verb for verb, _ in run.heard] == [OperatorCommand.STOP]
    run.heard.clear()


def test_a_token_that_is_being_typed_stays_when_stop_is_pressed(run: Run, tab: Callable[..., Page]) -> None:
    page = tab()
    page.goto(f"http://127.0.0.1:{run.port}/")
    expect(page.locator("#state-word")).to_have_text("holding")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("textbox", name="Token").fill(run.control.token)
    page.get_by_role("button", name="Stop").click()
    with page.expect_response("**/say"):
        page.keyboard.press("Enter")
    assert [verb for verb, _ in run.heard] == [OperatorCommand.STOP]
    run.heard.clear()
