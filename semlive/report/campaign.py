"""Many logs, or one long log's pairs, analysed anew on all cores or on a Dask cluster."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from semlive.errors import BadInput, SemliveError
from semlive.report.export.export import export_log
from semlive.report.export.fields import Format
from semlive.service.analysis.result_json import result_json
from semlive.service.log.pairs import has_images
from semlive.service.replay.parallel_correlation import PairMaps, correlate_pairs, pair_numbers, replay_from_maps
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, ReplayResult, Source

_JOBS_PER_CORE = 4


@dataclass(frozen=True, slots=True)
class LogOutcome:
    """What became of one log.

    Attributes:
        log: its path.
        name: its group in the combined file.
        error: why it failed, one sentence; None if it did not.
        told: its result as `semlive replay --json` prints it; None if it failed.
        wall_s: seconds it took.
    """

    log: str
    name: str
    error: str | None
    told: dict[str, Any] | None
    wall_s: float

    def row(self) -> dict[str, Any]:
        """The log in one line of the summary; empty where it failed."""
        told = self.told or {}
        elastic = told.get("elastic") or {}
        row = {"log": self.log, "name": self.name, "error": self.error or "", "pairs": told.get("pairs"), "method": told.get("method")}
        for name, short in (("youngs_modulus_gpa", "e_gpa"), ("poissons_ratio", "poisson")):
            row[short], row[short + "_sigma"] = (elastic.get(name, {}).get(part) for part in ("value", "sigma"))
        row["noise_floor_px"] = told.get("noise_floor_px")
        for axis, name in enumerate("xy"):
            row[f"distortion_rms_{name}_px"] = told["distortion"]["rms_px"][axis] if told else None
            row[f"drift_end_{name}_px"] = told["frames"][-1]["drift_end_px"][axis] if told else None
        return {**row, "warnings": len(told.get("warnings", ())), "wall_s": round(self.wall_s, 3)}


def reanalyse(
    asked: Sequence[ReplayRequest], out: Path, executor: Callable[[], Any], progress: Callable[[int, int], None] | None = None
) -> tuple[LogOutcome, ...]:
    """Analyse logs and write ``summary.csv``, ``summary.json`` and ``combined.h5``.

    Args:
        asked: one for each log.
        out: folder.
        executor: context that gives somebody who works (see `process_pool` and `dask_executor`).
        progress: told jobs done and jobs in all.

    Raises:
        BadInput: `out` cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{out}: cannot be made ({error.strerror}); give a folder that can be written.") from error
    names = _names([one.log for one in asked])
    if len(asked) == 1 and _source(asked[0]) is Source.IMAGES:
        done = [_one_long_log(asked[0], names[0], out, executor, progress)]
    else:
        done = _campaign(asked, names, out, executor, progress)
    _combine(done, out)
    return tuple(done)


@contextmanager
def process_pool(count: int | None = None) -> Iterator[Executor]:
    """Processes of this machine, one for each core, each with one thread for its numerics."""
    before = {name: os.environ.get(name) for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    os.environ.update(dict.fromkeys(before, "1"))  # read by the processes that are spawned next
    try:
        with ProcessPoolExecutor(count or os.cpu_count(), mp_context=multiprocessing.get_context("spawn")) as pool:
            yield pool
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """An existing Dask cluster, whose workers have semlive installed and see logs and output under the same paths.

    Raises:
        BadInput: distributed is not installed, or nobody answers.
    """
    try:
        from distributed import Client  # noqa: PLC0415
    except ImportError:
        raise BadInput(f"--dask {address}: distributed is not installed; pip install semlive[dask].") from None
    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(f"--dask {address}: nobody answers there ({error}); give the scheduler's address, tcp://host:8786.") from error
    with client:
        yield client.get_executor(pure=False)


def analyse_log(asked: ReplayRequest, name: str, part: str) -> LogOutcome:
    """One log, in whatever process: its fields go to a file of its own; what goes wrong is told, not raised."""
    begin = time.perf_counter()
    try:
        done = export_log(asked, Format.HDF5, Path(part))
    except Exception as error:
        said = str(error) if isinstance(error, SemliveError) else f"{type(error).__name__}: {error}"
        return LogOutcome(str(asked.log), name, said, None, time.perf_counter() - begin)
    return LogOutcome(str(asked.log), name, None, result_json(done.result, done.settings), time.perf_counter() - begin)


def _campaign(
    asked: Sequence[ReplayRequest],
    names: Sequence[str],
    out: Path,
    executor: Callable[[], Any],
    progress: Callable[[int, int], None] | None,
) -> list[LogOutcome]:
    """All logs; one whose process dies is told as failed, and those that died with it are begun again, each on its own."""
    jobs = {at: (one, names[at], str(_part(out, names[at]))) for at, one in enumerate(asked)}
    found: dict[int, LogOutcome] = {}
    for round_of in ([list(jobs)], [[at] for at in jobs]):
        for group in round_of:
            left = [at for at in group if at not in found]
            if left:
                with executor() as pool:
                    futures = {pool.submit(analyse_log, *jobs[at]): at for at in left}
                    for future in as_completed(futures):
                        _take(future, futures[future], jobs, found, alone=len(group) == 1)
                        if progress is not None:
                            progress(len(found), len(jobs))
    return [found[at] for at in jobs]


def _take(
    future: Future[LogOutcome], at: int, jobs: dict[int, tuple[ReplayRequest, str, str]], found: dict[int, LogOutcome], *, alone: bool
) -> None:
    try:
        found[at] = future.result()
    except Exception as error:
        if alone or not isinstance(error, BrokenProcessPool):
            asked, name, _ = jobs[at]
            found[at] = LogOutcome(str(asked.log), name, f"its process died ({type(error).__name__}); is there memory enough?", None, 0.0)


def _one_long_log(
    asked: ReplayRequest, name: str, out: Path, executor: Callable[[], Any], progress: Callable[[int, int], None] | None
) -> LogOutcome:
    """The pairs of one log correlated by many, then estimated here in their order."""
    begin = time.perf_counter()
    try:
        with executor() as pool:
            done = _correlated_by_many(asked, pool, out, name, progress)
    except SemliveError as error:
        return LogOutcome(str(asked.log), name, str(error), None, time.perf_counter() - begin)
    return LogOutcome(str(asked.log), name, None, result_json(done.result, done.settings), time.perf_counter() - begin)


def _correlated_by_many(
    asked: ReplayRequest, pool: Executor, out: Path, name: str, progress: Callable[[int, int], None] | None
) -> ReplayResult:
    numbers = pair_numbers(asked)
    size = max(1, len(numbers) // (_JOBS_PER_CORE * (os.cpu_count() or 1)))
    parts = [numbers[at : at + size] for at in range(0, len(numbers), size)]
    futures = [pool.submit(correlate_pairs, asked, part) for part in parts]

    def arriving() -> Iterator[PairMaps]:
        for done, future in enumerate(futures, start=1):
            yield from future.result()
            if progress is not None:
                progress(done, len(futures))

    def replayed(_: ReplayRequest, watch: ReplayCallbacks | None) -> ReplayResult:
        return replay_from_maps(asked, arriving(), watch)

    return export_log(asked, Format.HDF5, _part(out, name), by=replayed)


def _source(asked: ReplayRequest) -> Source:
    return asked.source or (Source.IMAGES if has_images(asked.log) else Source.DISPARITY)


def _names(logs: Sequence[Path]) -> list[str]:
    """Each log's name, numbered where two are alike."""
    found: list[str] = []
    for log in logs:
        name, again = log.name.removesuffix(".mcap"), 2
        while name in found:
            name, again = f"{log.name.removesuffix('.mcap')}_{again}", again + 1
        found.append(name)
    return found


def _part(out: Path, name: str) -> Path:
    return out / f"{name}.part.h5"


def _combine(done: Sequence[LogOutcome], out: Path) -> None:
    rows = [one.row() for one in done]
    with (out / "summary.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    (out / "summary.json").write_text(json.dumps([asdict(one) for one in done], indent=1) + "\n", encoding="utf-8")
    whole = out / "combined.h5.part"
    with h5py.File(whole, "w") as file:
        logs, summary = file.create_group("logs"), file.create_group("summary")
        for one in done:
            part = _part(out, one.name)
            if one.error is None:
                with h5py.File(part) as own:
                    group = logs.create_group(one.name)
                    for name, value in own.attrs.items():
                        group.attrs[name] = value
                    for name in own:
                        own.copy(name, group)
            part.unlink(missing_ok=True)
        for name in rows[0]:
            values = [row[name] for row in rows]
            if any(isinstance(value, str) for value in values):
                summary.create_dataset(name, data=["" if value is None else value for value in values], dtype=h5py.string_dtype())
            else:
                summary.create_dataset(name, data=np.array([np.nan if value is None else value for value in values], dtype=np.float64))
    whole.replace(out / "combined.h5")
