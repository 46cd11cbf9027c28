"""An unexpected error is one line on the terminal; the full traceback is available on request."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from semlive.formats.log.messages import LogLineMessage, from_json
from semlive.service.daemon.callbacks import log_loop_error
from semlive.service.log.files import messages, segment_path
from semlive.service.log.recording import Recorder
from semlive.service.log.run_log import RunLog
from semlive.service.runtime.clock import SystemClock

FAILING = """
import errno, sys, threading
from semlive.cli.app import app, run_app

def broken():
    raise RuntimeError("broken\\x1b[2J\\nin two lines")

@app.callback()
def fail(thread: bool = False, full: bool = False):
    if full:
        raise OSError(errno.ENOSPC, "No space left on device", "/data/page.html")
    if not thread:
        broken()
    other = threading.Thread(target=broken)
    other.start()
    other.join()
    sys.exit(0)

sys.exit(run_app())
"""


def failing(*arguments: str, **environment: str) -> tuple[int, str]:
    command = [sys.executable, "-c", FAILING, *arguments, "demo", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env={**os.environ, **environment}, check=False)
    return done.returncode, done.stderr


@pytest.mark.parametrize(("options", "code"), [((), 1), (("--thread",), 0)])
def test_an_unexpected_error_gives_one_error_line(options: tuple[str, ...], code: int) -> None:
    returned, printed = failing(*options)
    assert returned == code
    assert printed.count("\n") == 1
    assert printed.startswith("semlive itself failed (RuntimeError: broken\\x1b[2J in two lines); set SEMLIVE_TRACEBACK=1")


def test_a_full_disk_is_reported_with_its_path() -> None:
    assert failing("--full") == (1, "/data/page.html: No space left on device; make room or change the rights, or give another path\n")


def test_the_trace_is_shown_on_request() -> None:
    returned, printed = failing(SEMLIVE_TRACEBACK="1")
    assert returned == 1
    assert "Traceback" in printed


def test_what_the_loop_did_not_expect_goes_into_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clock = SystemClock()
    recorder = Recorder(segment_path(tmp_path, "run", 0), clock, lambda _: None)
    try:
        raise ValueError("a connection broke")
    except ValueError as error:
        log_loop_error(RunLog(recorder), clock, {"message": "in a task", "exception": error})
    log_loop_error(RunLog(recorder), clock, {"message": "no exception at all"})
    assert recorder.close(10.0)
    reported = [from_json(item.topic, item.payload) for item in messages(tmp_path) if item.topic == "/log"]
    assert [item.level for item in reported if isinstance(item, LogLineMessage)] == ["error", "error"]
    assert "ValueError: a connection broke" in str(reported[0])
    assert capsys.readouterr() == ("", "")
