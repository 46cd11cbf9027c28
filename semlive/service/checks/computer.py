"""Checks of the computer: clock, processor, disk, and cache of compiled kernels."""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from semlive.data.checks import Finding, Verdict
from semlive.service.runtime.jit_cache import VARIABLE, configure_jit_cache, may_write

STEP_S = 1e-3  # change of UTC relative to the monotonic clock during the test; a larger one is a step of the clock
CLOCK_TEST_S = 0.3
CLOCK_TOLERANCE_S = 0.1  # largest acceptable uncertainty of a network time service
_COMMAND_TIMEOUT_S = 5.0
_STA_UNSYNC = 0x40


def check_clock_rate(duration_s: float = CLOCK_TEST_S) -> Finding:
    """Whether UTC and the monotonic clock, which a run uses, have the same rate."""
    offset_s = time.time() - time.monotonic()
    time.sleep(duration_s)
    change_s = time.time() - time.monotonic() - offset_s
    observation = f"UTC moved by {1e3 * change_s:+.3f} ms against the monotonic clock in {duration_s:g} s"
    if abs(change_s) <= STEP_S:
        return Finding("clock", observation, Verdict.OK)
    return Finding(
        "clock", observation, Verdict.FAILED, "a program sets the clock; wait until the time service is stable, then check again"
    )


def check_time_service() -> Finding:
    """Whether a time service synchronises the clock, if the system reports it."""
    advice = "enable the time service (Linux: timedatectl set-ntp true; Windows: w32tm /resync), also on the computer of the SEM"
    if sys.platform == "linux" and sys.maxsize > 2**32:
        state = _adjtimex()
        if state is not None:
            synchronised, uncertainty_s = state
            observation = (
                f"synchronised by a time service, within {uncertainty_s:.3f} s"
                if synchronised
                else "no time service synchronises the clock"
            )
            good = synchronised and uncertainty_s < CLOCK_TOLERANCE_S
            return Finding("time service", observation, Verdict.OK if good else Verdict.UNKNOWN, "" if good else advice)
    if sys.platform == "win32":
        output = _output_of(["w32tm", "/query", "/status"])
        good = output is not None and "0x80070426" not in output
        return Finding("time service", "runs" if good else "does not run", Verdict.OK if good else Verdict.UNKNOWN, "" if good else advice)
    return Finding("time service", "the system does not report it", Verdict.UNKNOWN, advice)


def processor() -> Finding:
    """Whether the processor has the vector units for which the kernels are compiled."""
    from numpy._core._multiarray_umath import __cpu_features__ as features  # noqa: PLC0415  (numpy has no public name for it)

    cores = os.cpu_count() or 1
    machine = platform.machine().lower()
    available: Mapping[str, bool] = features
    vector_units = [name for name in ("AVX512F", "AVX2", "FMA3", "ASIMD") if available.get(name)]
    observation = f"{cores} cores, {machine}, {', '.join(vector_units) or 'no vector_units vector unit'}"
    fast = available.get("ASIMD", False) or (available.get("AVX2", False) and available.get("FMA3", False))
    if not fast:
        return Finding("processor", observation, Verdict.UNKNOWN, "correlation takes two to four times as long; use a computer with AVX2")
    if cores < 2:
        return Finding("processor", observation, Verdict.UNKNOWN, "use two cores, so that the analysis does not delay the control")
    return Finding("processor", observation, Verdict.OK)


def jit_cache() -> Finding:
    """Whether compiled kernels can be stored, and exist."""
    folder = configure_jit_cache(os.environ)
    if not may_write(folder):
        advice = f"set {VARIABLE} to a writable folder; without one every start compiles again for half a minute"
        return Finding("JIT cache", f"{folder} is not writable", Verdict.FAILED, advice)
    count = sum(1 for _ in folder.rglob("*.nbi"))
    if not count:
        return Finding(
            "JIT cache", f"{folder}, empty", Verdict.UNKNOWN, "the first run compiles for half a minute; semlive doctor --warm does it now"
        )
    return Finding("JIT cache", f"{folder}, {count} compiled functions", Verdict.OK)


def disk(folder: Path, needed_bytes: int | None) -> tuple[Finding, ...]:
    """Free space for the log, and the duration of a synced write.

    Args:
        folder: folder of the logs; if it does not exist, the nearest existing parent is checked.
        needed_bytes: expected size of the log; None if unknown.
    """
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    free = shutil.disk_usage(existing).free
    observation = f"{existing}: {free / 1e9:.1f} GB free" + (
        "" if needed_bytes is None else f", the run may need {needed_bytes / 1e9:.1f} GB"
    )
    needed = 1_000_000_000 if needed_bytes is None else needed_bytes
    verdict = Verdict.OK if free > 2 * needed else Verdict.UNKNOWN if free > needed else Verdict.FAILED
    advice = "" if verdict is Verdict.OK else "free space, or set run.folder to a larger disk; a full disk pauses a run"
    return Finding("disk", observation, verdict, advice), _sync_speed(existing)


def _sync_speed(folder: Path, size: int = 2**20, times: int = 5) -> Finding:
    """Duration of a synced write of a megabyte; the log is synced after every chunk."""
    path, durations_s = folder / f".semlive-doctor-{os.getpid()}", []
    try:
        try:
            with path.open("xb", buffering=0) as file:
                for _ in range(times):
                    began = time.monotonic()
                    file.write(os.urandom(size))
                    os.fsync(file.fileno())
                    durations_s.append(time.monotonic() - began)
        finally:
            path.unlink(missing_ok=True)
    except OSError as error:
        return Finding(
            "log folder", f"{folder} is not writable ({error.strerror})", Verdict.FAILED, "correct run.folder or its permissions"
        )
    worst_s = max(durations_s)
    observation = f"1 MB is synced within {1e3 * worst_s:.0f} ms ({folder})"
    if worst_s < 0.2:
        return Finding("log folder", observation, Verdict.OK)
    remedy = "write the log to a disk of this computer, not to a network share or a memory stick; copy it afterwards"
    return Finding("log folder", observation, Verdict.UNKNOWN if worst_s < 2.0 else Verdict.FAILED, remedy)


def _adjtimex() -> tuple[bool, float] | None:
    """Whether the clock of the kernel is synchronised, and its maximum error, s; None if the call fails."""
    try:
        call = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError):
        return None
    timex = (ctypes.c_long * 64)()  # struct timex: modes, offset, freq, maxerror, esterror, status, ...; modes 0 only reads
    if call(timex) < 0:
        return None
    return not timex[5] & 0xFFFFFFFF & _STA_UNSYNC, timex[3] * 1e-6


def _output_of(command: list[str]) -> str | None:
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=_COMMAND_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout if result.returncode == 0 else None
