"""Old runs are deleted only on request, and none that could still be needed."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.errors import BadInput
from semlive.formats.log.messages import LogLineMessage, ResultMessage, StateMessage
from semlive.service.log.files import segment_path, segments
from semlive.service.log.lock import run_lock
from semlive.service.log.recording import Recorder
from semlive.service.log.retention import Retention, delete, select_runs

from ...clocks import HandClock

NOW_S = 2e9
DAY_S = 86_400.0


def make_run(root: Path, name: str, age_days: float, state: str = "complete", concluded: bool = True) -> Path:
    """A run in two segments that ended so long ago."""
    folder = root / name
    folder.mkdir(parents=True)
    recorder = Recorder(segment_path(folder, name, 0), HandClock(1), pytest.fail, segment_bytes=5_000)
    recorder.write("/state", StateMessage(time_ns=1, before="imaging", after=state, cause="done", step=None, guards={}))
    recorder.write("/log", LogLineMessage(time_ns=1, level="info", text="x" * 6_000))
    assert recorder.flush()
    if concluded:
        recorder.write("/result", ResultMessage({"pairs": 1}))
    assert recorder.close()
    assert len(segments(folder)) == 2
    aged(folder, age_days)
    return folder


def aged(folder: Path, age_days: float) -> None:
    ended_s = NOW_S - age_days * DAY_S
    for path in folder.iterdir():
        os.utime(path, (ended_s, ended_s))


def beyond(root: Path, **limits: float) -> list[str]:
    return [item.folder.name for item in select_runs(root, Retention(**limits), NOW_S) if item.deleted_because]


def test_the_oldest_go_first_and_only_as_many_as_the_limit_asks(tmp_path: Path) -> None:
    for name, age_days in (("young", 1), ("middle", 20), ("oldest", 40)):
        make_run(tmp_path, name, age_days)
    (tmp_path / "not-a-run").mkdir()
    one_gb = select_runs(tmp_path, Retention(), NOW_S)[0].size / 1e9
    assert beyond(tmp_path) == []
    assert beyond(tmp_path, days=30) == ["oldest"]
    assert beyond(tmp_path, days=10) == ["oldest", "middle"]
    assert beyond(tmp_path, gb=2.5 * one_gb) == ["oldest"]
    assert beyond(tmp_path, gb=0.0) == ["oldest", "middle", "young"]


def unfinished(folder: Path) -> None:
    newest = segments(folder)[-1]
    newest.rename(newest.with_name(newest.name + ".part"))


def noted(folder: Path) -> None:
    (folder / "notes.txt").write_text("the good one")


def damaged(folder: Path) -> None:
    newest = segments(folder)[-1]
    newest.write_bytes(newest.read_bytes()[:-50])


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (unfinished, "not finished"),
        (noted, "holds notes.txt"),
        (damaged, "damaged"),
        (lambda folder: aged(folder, -400), "newer than this computer's clock"),
    ],
)
def test_a_run_that_could_be_needed_is_retained_whatever_the_limit(tmp_path: Path, spoil: Callable[[Path], None], why: str) -> None:
    folder = make_run(tmp_path, "one", 400)
    assert beyond(tmp_path, days=30) == ["one"]
    spoil(folder)
    (run,) = select_runs(tmp_path, Retention(days=0, gb=0), NOW_S)
    assert why in (run.retained_because or "")
    assert run.deleted_because is None


@pytest.mark.parametrize(("state", "concluded"), [("aborted", True), ("holding", True), ("complete", False)])
def test_a_resumable_run_is_retained(tmp_path: Path, state: str, concluded: bool) -> None:
    make_run(tmp_path, "one", 400, state, concluded)
    (run,) = select_runs(tmp_path, Retention(days=30), NOW_S)
    assert "can be resumed" in (run.retained_because or "")


def test_a_run_at_work_or_written_to_since_is_not_deleted(tmp_path: Path) -> None:
    folder = make_run(tmp_path, "one", 400)
    (run,) = select_runs(tmp_path, Retention(days=30), NOW_S)
    with run_lock(folder):
        assert beyond(tmp_path, days=30) == []
        with pytest.raises(BadInput, match="another semlive"):
            delete(run, NOW_S)
    noted(folder)
    with pytest.raises(BadInput, match=r"notes\.txt"):
        delete(run, NOW_S)
    assert len(segments(folder)) == 2


def test_the_command_lists_runs_first_and_deletes_on_request(tmp_path: Path) -> None:
    old, aborted = make_run(tmp_path, "old", 40), make_run(tmp_path, "aborted", 40, "aborted")
    half = tmp_path / ".gone.deleting"
    half.mkdir()
    (half / "gone.000.mcap").write_bytes(b"")
    # The command asks the real clock, which is before NOW_S.
    for folder in (old, aborted):
        for path in folder.iterdir():
            os.utime(path, (1e9, 1e9))
    named = CliRunner().invoke(app, ["prune", str(tmp_path), "--days", "30"])
    assert named.exit_code == 0, named.output
    assert "old: " in named.output
    assert "1 runs would be deleted" in named.output
    assert old.is_dir()
    assert half.is_dir()
    done = CliRunner().invoke(app, ["prune", str(tmp_path), "--days", "30", "--delete", "--json"])
    reported = {Path(item["run"]).name: item for item in json.loads(done.output)["runs"]}
    assert reported["old"]["deleted"]
    assert "can be resumed" in reported["aborted"]["kept_because"]
    assert not old.exists()
    assert not half.exists()
    assert aborted.is_dir()
    assert isinstance(CliRunner().invoke(app, ["prune", str(tmp_path)]).exception, BadInput)
