"""Child process of the analysis during a run.

The process reads the growing log, up to the number of inputs that it receives on standard input, and writes its outputs to standard output.
After a crash, a new process reads the log from the beginning.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

from semlive import dic, pipeline
from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.messages import INPUT_TOPICS
from semlive.service.analysis.output import OutputStream, lower_priority
from semlive.service.analysis.pipe import LOG_REPLACED, AnalysisOutput, AnalysisReady, read_counts
from semlive.service.analysis.step import WorkerState, background_work, process_message
from semlive.service.log.tail import LogReplaced, LogTail
from semlive.service.runtime.blas import limit_blas_threads
from semlive.service.runtime.garbage import enable_garbage_collection
from semlive.service.runtime.memory import trim_heap
from semlive.service.runtime.pause import pause
from semlive.service.storage.map_store import offload_pair
from semlive.service.storage.pair_archive import PairArchive

_POLL_S = 0.01
"""Interval of the polls of the log: the recorder needs some milliseconds from the announcement of a message to its bytes in the log."""


def main() -> None:
    """Main function of the child process; it ends with its standard input."""
    enable_garbage_collection()
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path, required=True, help="the growing log")
    parser.add_argument("--inputs", type=int, default=0, help="number of input messages that the log already contains")
    parser.add_argument("--skip", type=int, default=0, help="number of outputs that the log already contains")
    parser.add_argument("--began-ns", type=int, default=None, help="log time of the first message of the log; omitted for an empty log")
    parser.add_argument("--beat", action="store_true", help="also write a heartbeat every second")
    arguments = parser.parse_args()
    lower_priority()
    limit_blas_threads()
    counts = chain((arguments.inputs,), read_counts(sys.stdin.buffer))
    try:
        _analyse_log(_inputs(arguments.log, counts, arguments.began_ns), arguments.skip, arguments.beat)
    except LogReplaced as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(LOG_REPLACED)


def _analyse_log(inputs: Iterable[LogMessage], skip: int, beat: bool) -> None:
    """Write the outputs to standard output, without those that are already in the log."""
    state, archive = WorkerState(), PairArchive()
    with OutputStream(sys.stdout.buffer, beat) as stream:
        for message in inputs:
            with stream.busy():
                analysis = state.analysis
                state, outputs = process_message(state, message)
                skip = _write(stream, _warmed_up(state, message, outputs), skip)
                state, outputs = background_work(state)
                skip = _write(stream, outputs, skip)
                state = _offloaded(state, analysis, archive)


def _write(stream: OutputStream, outputs: Iterable[AnalysisOutput], skip: int) -> int:
    """Write all outputs but the first `skip`, which the log already contains; return how many remain to be skipped."""
    for output in outputs:
        if skip > 0:
            skip -= 1
        else:
            stream.write(output)
    return skip


def _inputs(log: Path, counts: Iterable[int], began_ns: int | None = None) -> Iterator[LogMessage]:
    """Yield the input messages of a growing log; each count is the number of input messages up to which the log is read.

    Raises:
        LogReplaced: the first message of the log is not of the time `began_ns`.
    """
    tail, yielded = LogTail(log), 0
    for count in counts:
        while yielded < count:
            for message in tail.poll():
                if began_ns not in (None, message.log_time_ns):
                    raise LogReplaced(f"{log}: is not the log of this run any more; look at what became of the folder.")
                began_ns = None
                if message.topic in INPUT_TOPICS:
                    yielded += 1
                    yield message
            if yielded < count:
                pause(_POLL_S)


def _offloaded(state: WorkerState, analysis: pipeline.AnalysisState | None, archive: PairArchive) -> WorkerState:
    """If `analysis` is not the present one: move the stored data of the new pair into unnamed files, bit by bit equal."""
    if state.analysis is None or state.analysis is analysis:
        return state
    offloaded = offload_pair(state.analysis, state.analysis.pairs[-1].pair, (), archive)
    archive.flush()
    trim_heap()
    return replace(state, analysis=offloaded)


def _warmed_up(state: WorkerState, message: LogMessage, outputs: Iterable[LogMessage]) -> Iterable[AnalysisOutput]:
    """After the configuration of the run: compile the kernels, then send the last output, the line for `/log`, as `AnalysisReady`."""
    if message.topic != "/run" or state.settings is None:
        return outputs
    dic.warm_up(state.settings.dic)
    *notices, line = outputs
    return (*notices, AnalysisReady(line))


if __name__ == "__main__":
    main()
