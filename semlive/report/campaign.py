"""Analysis of many logs, or of the pairs of one long log, on all cores or on a Dask cluster."""

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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from semlive.errors import BadInput, SemliveError
from semlive.kernels.threads import update_thread_count
from semlive.report.export.export import export_log
from semlive.report.export.fields import Format
from semlive.report.export.hdf5_writer import add_stack
from semlive.service.analysis.result_json import result_json
from semlive.service.log.pairs import has_images
from semlive.service.replay.parallel_correlation import PairMaps, correlate_pairs, pair_numbers, replay_from_maps
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, ReplayResult, Source
from semlive.service.runtime.blas import limit_blas_threads

_JOBS_PER_CORE = 4


@dataclass(frozen=True, slots=True)
class LogOutcome:
    """Outcome of the analysis of one log.

    Attributes:
        log: path of the log.
        name: group in the combined file.
        error: reason of a failure; None without failure.
        result: result in the form of `semlive replay --json`; None after a failure.
        wall_s: duration of the analysis, s.
    """

    log: str
    name: str
    error: str | None
    result: dict[str, Any] | None
    wall_s: float

    def to_json(self) -> dict[str, Any]:
        """The outcome with the keys of ``summary.json``."""
        return {"log": self.log, "name": self.name, "error": self.error, "told": self.result, "wall_s": self.wall_s}

    def row(self) -> dict[str, Any]:
        """Row of the log in the summary; result columns are empty after a failure."""
        result = self.result or {}
        elastic = result.get("elastic") or {}
        row = {"log": self.log, "name": self.name, "error": self.error or "", "pairs": result.get("pairs"), "method": result.get("method")}
        for name, short in (("youngs_modulus_gpa", "e_gpa"), ("poissons_ratio", "poisson")):
            row[short], row[short + "_sigma"] = (elastic.get(name, {}).get(part) for part in ("value", "sigma"))
        row["noise_floor_px"] = result.get("noise_floor_px")
        for axis, name in enumerate("xy"):
            row[f"distortion_rms_{name}_px"] = result["distortion"]["rms_px"][axis] if result else None
            row[f"drift_end_{name}_px"] = result["frames"][-1]["drift_end_px"][axis] if result else None
        return {**row, "warnings": len(result.get("warnings", ())), "wall_s": round(self.wall_s, 3)}


def reanalyse(
    requests: Sequence[ReplayRequest], out: Path, executor: Callable[[], Any], progress: Callable[[int, int], None] | None = None
) -> tuple[LogOutcome, ...]:
    """Analyse logs and write ``summary.csv``, ``summary.json`` and ``combined.h5``.

    Args:
        requests: request for each log.
        out: output folder.
        executor: context that provides an executor (see `process_pool` and `dask_executor`).
        progress: called with the number of finished jobs and of all jobs.

    Raises:
        BadInput: `out` cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{out}: cannot be created ({error.strerror}); give a writable folder.") from error
    names = _names([request.log for request in requests])
    if len(requests) == 1 and _source(requests[0]) is Source.IMAGES:
        done = [_one_long_log(requests[0], names[0], out, executor, progress)]
    else:
        done = _campaign(requests, names, out, executor, progress)
    _combine(done, out)
    return tuple(done)


@contextmanager
def process_pool(count: int | None = None) -> Iterator[Executor]:
    """Processes of this machine, one for each core, each with one thread for its numerics."""
    # The limit is set in the processes, not in the environment of this one: Numba reads it again whenever it compiles.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count or os.cpu_count(), mp_context=context, initializer=use_one_thread) as pool:
        yield pool


def use_one_thread() -> None:
    """Limit kernels and linear algebra of this process to one thread: the start of a process of a pool."""
    os.environ["NUMBA_NUM_THREADS"] = "1"
    update_thread_count()
    limit_blas_threads()


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """An existing Dask cluster, whose workers have semlive installed and see logs and output under the same paths.

    Raises:
        BadInput: distributed is not installed, or the scheduler does not reply.
    """
    try:
        from distributed import Client  # noqa: PLC0415
    except ImportError:
        raise BadInput(f"--dask {address}: distributed is not installed; pip install semlive[dask].") from None
    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(f"--dask {address}: the scheduler does not reply ({error}); give its address, tcp://host:8786.") from error
    with client:
        yield client.get_executor(pure=False)


def analyse_log(request: ReplayRequest, name: str, part: str) -> LogOutcome:
    """Analyse one log in any process and write its fields to a separate file; a failure is returned, not raised."""
    begin = time.perf_counter()
    try:
        done = export_log(request, Format.HDF5, Path(part))
    except Exception as error:
        message = str(error) if isinstance(error, SemliveError) else f"{type(error).__name__}: {error}"
        return LogOutcome(str(request.log), name, message, None, time.perf_counter() - begin)
    return LogOutcome(str(request.log), name, None, result_json(done.result, done.settings), time.perf_counter() - begin)


def _campaign(
    requests: Sequence[ReplayRequest],
    names: Sequence[str],
    out: Path,
    executor: Callable[[], Any],
    progress: Callable[[int, int], None] | None,
) -> list[LogOutcome]:
    """Analyse all logs; if a process dies, its log counts as failed and other logs of the broken pool are repeated one by one."""
    jobs = {at: (request, names[at], str(_part(out, names[at]))) for at, request in enumerate(requests)}
    outcomes: dict[int, LogOutcome] = {}
    for round_of in ([list(jobs)], [[at] for at in jobs]):
        for group in round_of:
            remaining = [at for at in group if at not in outcomes]
            if remaining:
                with executor() as pool:
                    futures = {pool.submit(analyse_log, *jobs[at]): at for at in remaining}
                    for future in as_completed(futures):
                        _take(future, futures[future], jobs, outcomes, alone=len(group) == 1)
                        if progress is not None:
                            progress(len(outcomes), len(jobs))
    return [outcomes[at] for at in jobs]


def _take(
    future: Future[LogOutcome], at: int, jobs: dict[int, tuple[ReplayRequest, str, str]], outcomes: dict[int, LogOutcome], *, alone: bool
) -> None:
    try:
        outcomes[at] = future.result()
    except Exception as error:
        if alone or not isinstance(error, BrokenProcessPool):
            request, name, _ = jobs[at]
            outcomes[at] = LogOutcome(
                str(request.log), name, f"its process died ({type(error).__name__}); check that the memory suffices", None, 0.0
            )


def _one_long_log(
    request: ReplayRequest, name: str, out: Path, executor: Callable[[], Any], progress: Callable[[int, int], None] | None
) -> LogOutcome:
    """Correlate the pairs of one log in parallel, then estimate in order of time in this process."""
    begin = time.perf_counter()
    try:
        with executor() as pool:
            done = _correlated_by_many(request, pool, out, name, progress)
    except SemliveError as error:
        return LogOutcome(str(request.log), name, str(error), None, time.perf_counter() - begin)
    return LogOutcome(str(request.log), name, None, result_json(done.result, done.settings), time.perf_counter() - begin)


def _correlated_by_many(
    request: ReplayRequest, pool: Executor, out: Path, name: str, progress: Callable[[int, int], None] | None
) -> ReplayResult:
    numbers = pair_numbers(request)
    size = max(1, len(numbers) // (_JOBS_PER_CORE * (os.cpu_count() or 1)))
    parts = [numbers[at : at + size] for at in range(0, len(numbers), size)]
    futures = [pool.submit(correlate_pairs, request, part) for part in parts]

    def arriving() -> Iterator[PairMaps]:
        for done, future in enumerate(futures, start=1):
            yield from future.result()
            if progress is not None:
                progress(done, len(futures))

    def replayed(_: ReplayRequest, watch: ReplayCallbacks | None) -> ReplayResult:
        return replay_from_maps(request, arriving(), watch)

    return export_log(request, Format.HDF5, _part(out, name), by=replayed)


def _source(request: ReplayRequest) -> Source:
    return request.source or (Source.IMAGES if has_images(request.log) else Source.DISPARITY)


def _names(logs: Sequence[Path]) -> list[str]:
    """Name of each log, numbered where names are equal."""
    outcomes: list[str] = []
    for log in logs:
        name, again = log.name.removesuffix(".mcap"), 2
        while name in outcomes:
            name, again = f"{log.name.removesuffix('.mcap')}_{again}", again + 1
        outcomes.append(name)
    return outcomes


def _part(out: Path, name: str) -> Path:
    return out / f"{name}.part.h5"


def _combine(done: Sequence[LogOutcome], out: Path) -> None:
    rows = [outcome.row() for outcome in done]
    with (out / "summary.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    (out / "summary.json").write_text(json.dumps([outcome.to_json() for outcome in done], indent=1) + "\n", encoding="utf-8")
    whole = out / "combined.h5.part"
    with h5py.File(whole, "w") as file:
        logs, summary = file.create_group("logs"), file.create_group("summary")
        for outcome in done:
            part = _part(out, outcome.name)
            if outcome.error is None:
                with h5py.File(part) as own:
                    group = logs.create_group(outcome.name)
                    for name, value in own.attrs.items():
                        group.attrs[name] = value
                    for name in own:
                        if name != "stack":
                            own.copy(name, group)
                    add_stack(group)
            part.unlink(missing_ok=True)
        for name in rows[0]:
            values = [row[name] for row in rows]
            if any(isinstance(value, str) for value in values):
                summary.create_dataset(name, data=["" if value is None else value for value in values], dtype=h5py.string_dtype())
            else:
                summary.create_dataset(name, data=np.array([np.nan if value is None else value for value in values], dtype=np.float64))
    whole.replace(out / "combined.h5")
