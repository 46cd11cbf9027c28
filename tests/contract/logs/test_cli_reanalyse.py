"""`semlive reanalyse`: many logs by many processes, here and on a Dask cluster; what is wrong with one does not stop the rest."""

from __future__ import annotations

import csv
import importlib
import json
import os
import shutil
import signal
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from semlive.kernels.threads import thread_count, update_thread_count
from semlive.report import campaign
from semlive.report.campaign import LogOutcome, analyse_log, process_pool, reanalyse
from semlive.service.analysis.result_json import result_json
from semlive.service.replay.replay import ReplayRequest, ReplayResult, replay

Semlive = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def logs(short: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A good log, a truncated one, the good one again in another folder under the same name."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "again").mkdir()
    torn = folder / "torn.mcap"
    torn.write_bytes(short.read_bytes()[:2000])
    return [short, torn, Path(shutil.copy(short, folder / "again"))]


@pytest.fixture(scope="module")
def own(short: Path) -> ReplayResult:
    """What the good log's replay finds."""
    return replay(ReplayRequest(short))


def checked(out: Path, own: ReplayResult) -> None:
    reported = json.loads(json.dumps(result_json(own.result, own.settings)))
    assert sorted(path.name for path in out.iterdir()) == ["combined.h5", "summary.csv", "summary.json"]
    with h5py.File(out / "combined.h5") as file:
        assert set(file["logs"]) == {"short", "short_2"}
        for group in file["logs"].values():
            assert json.loads(group["result"].asstr()[()]) == reported
            np.testing.assert_array_equal(group["frames/7/eyy"], own.result.frames[7].strain.eyy)
            np.testing.assert_array_equal(group["stack/eyy"][7], own.result.frames[7].strain.eyy)
        assert list(file["summary/name"].asstr()) == ["short", "torn", "short_2"]
        assert file["summary/noise_floor_px"][0] == reported["noise_floor_px"]
        assert np.isnan(file["summary/noise_floor_px"][1])
    with (out / "summary.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [bool(row["error"]) for row in rows] == [False, True, False]
    assert rows[0]["pairs"] == "4"


def test_all_cores_and_one_truncated_log(semlive: Semlive, logs: list[Path], own: ReplayResult, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, printed, err = semlive("reanalyse", *map(str, logs), "-o", str(out), "--jobs", "2", "--json")
    assert code == 1
    assert "1 of 3 logs failed, the first" in err
    reported = json.loads(printed)
    assert reported["failed"] == 1
    assert [row["pairs"] for row in reported["logs"]] == [4, None, 4]
    checked(out, own)


def test_one_thread_in_each_process_and_as_many_as_before_in_this_one() -> None:
    before = thread_count()
    with process_pool(1) as pool:
        assert pool.submit(thread_count).result() == 1
        update_thread_count()  # as at every compilation: the limit of those processes then was that of this one, too
        assert thread_count() == before


def test_a_dask_cluster(logs: list[Path], own: ReplayResult, tmp_path: Path) -> None:
    distributed = importlib.import_module("distributed")  # here, because each process that collects the tests needs 0.7 s for it
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as workers:
        done = reanalyse([ReplayRequest(log) for log in logs], tmp_path / "out", lambda: campaign.dask_executor(workers.scheduler_address))
    assert [item.error is None for item in done] == [True, False, True]
    checked(tmp_path / "out", own)


def test_nobody_at_the_scheduler_s_address(semlive: Semlive, short: Path, tmp_path: Path) -> None:
    code, out, err = semlive("reanalyse", str(short), "-o", str(tmp_path / "out"), "--dask", "nonsense://nowhere")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "--dask nonsense://nowhere: the scheduler does not reply" in err


def dying(request: ReplayRequest, name: str, part: str) -> LogOutcome:
    """A process that the system kills while it works on one of the logs."""
    if request.log.name.startswith("torn"):
        os.kill(os.getpid(), signal.SIGKILL)
    return analyse_log(request, name, part)


def test_a_process_that_dies_takes_no_other_log_with_it(logs: list[Path], tmp_path: Path) -> None:
    class Dying:
        """Submits the dying work in place of the work."""

        def __init__(self, pool: Executor) -> None:
            self._pool = pool

        def submit(self, _: Any, *arguments: Any) -> Any:
            return self._pool.submit(dying, *arguments)

    @contextmanager
    def executor() -> Any:
        with process_pool(1) as pool:
            yield Dying(pool)

    done = reanalyse([ReplayRequest(log) for log in logs[:2]], tmp_path / "out", executor)
    assert [item.error is None for item in done] == [True, False]
    assert "its process died" in (done[1].error or "")
