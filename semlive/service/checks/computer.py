"""What the computer brings: its clock, its processor, and where compiled kernels are kept."""

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

STEP_S = 1e-3  # of UTC against the monotonic clock while we look: more is a clock being set, not slewed
CLOCK_TEST_S = 0.3
CLOCK_TOLERANCE_S = 0.1  # what a network time service may be unsure by
_PATIENCE_S = 5.0
_STA_UNSYNC = 0x40


def check_clock_rate(looked_s: float = CLOCK_TEST_S) -> Finding:
    """Whether UTC runs with the monotonic clock, by which a run keeps its time."""
    before = time.time() - time.monotonic()
    time.sleep(looked_s)
    moved_s = time.time() - time.monotonic() - before
    said = f"UTC moved by {1e3 * moved_s:+.3f} ms against the monotonic clock in {looked_s:g} s"
    if abs(moved_s) <= STEP_S:
        return Finding("clock", said, Verdict.OK)
    return Finding("clock", said, Verdict.FAILED, "something sets the clock just now; let the time service settle, then look again")


def check_time_service() -> Finding:
    """Whether a time service keeps the clock right, where the system tells."""
    advice = "switch the time service on (Linux: timedatectl set-ntp true; Windows: w32tm /resync), and that of the SEM's computer too"
    if sys.platform == "linux" and sys.maxsize > 2**32:
        told = _adjtimex()
        if told is not None:
            synchronised, unsure_s = told
            said = f"kept by a time service, within {unsure_s:.3f} s" if synchronised else "no time service keeps it"
            good = synchronised and unsure_s < CLOCK_TOLERANCE_S
            return Finding("time service", said, Verdict.OK if good else Verdict.UNKNOWN, "" if good else advice)
    if sys.platform == "win32":
        done = _said(["w32tm", "/query", "/status"])
        good = done is not None and "0x80070426" not in done
        return Finding("time service", "runs" if good else "does not run", Verdict.GOOD if good else Verdict.OPEN, "" if good else advice)
    return Finding("time service", "this system does not tell", Verdict.UNKNOWN, advice)


def processor() -> Finding:
    """Whether the vector units are there that the kernels are compiled for."""
    from numpy._core._multiarray_umath import __cpu_features__ as features  # noqa: PLC0415  (numpy has no public name for it)

    cores = os.cpu_count() or 1
    machine = platform.machine().lower()
    known: Mapping[str, bool] = features
    wide = [name for name in ("AVX512F", "AVX2", "FMA3", "ASIMD") if known.get(name)]
    said = f"{cores} cores, {machine}, {', '.join(wide) or 'no wide vector unit'}"
    fast = known.get("ASIMD", False) or (known.get("AVX2", False) and known.get("FMA3", False))
    if not fast:
        return Finding(
            "processor", said, Verdict.UNKNOWN, "correlation works, but takes two to four times as long; use a computer with AVX2"
        )
    if cores < 2:
        return Finding("processor", said, Verdict.UNKNOWN, "give it two cores: analysis then does not compete with control")
    return Finding("processor", said, Verdict.OK)


def jit_cache() -> Finding:
    """Whether compiled kernels are kept, and are there already."""
    folder = configure_jit_cache(os.environ)
    if not may_write(folder):
        advice = f"set {VARIABLE} to a folder that may be written; without one every start compiles anew, for half a minute"
        return Finding("JIT cache", f"{folder} may not be written", Verdict.FAILED, advice)
    kept = sum(1 for _ in folder.rglob("*.nbi"))
    if not kept:
        return Finding(
            "JIT cache", f"{folder}, empty", Verdict.UNKNOWN, "the first run compiles for half a minute; semlive doctor --warm does it now"
        )
    return Finding("JIT cache", f"{folder}, {kept} compiled functions", Verdict.OK)


def disk(folder: Path, needed_bytes: int | None) -> tuple[Finding, ...]:
    """Room for the log, and how long the disk takes to keep what it was given.

    Args:
        folder: of the logs; the nearest folder above that exists is looked at.
        needed_bytes: what the run is going to write, if that is known.
    """
    at = folder
    while not at.exists() and at != at.parent:
        at = at.parent
    free = shutil.disk_usage(at).free
    said = f"{at}: {free / 1e9:.1f} GB free" + ("" if needed_bytes is None else f", the run may need {needed_bytes / 1e9:.1f} GB")
    needed = 1_000_000_000 if needed_bytes is None else needed_bytes
    room = Verdict.OK if free > 2 * needed else Verdict.UNKNOWN if free > needed else Verdict.FAILED
    advice = "" if room is Verdict.OK else "make room, or set run.folder to a larger disk; a full disk pauses a run"
    return Finding("disk", said, room, advice), _sync_speed(at)


def _sync_speed(folder: Path, size: int = 2**20, times: int = 5) -> Finding:
    """How long a megabyte takes until the disk has it for good; the log is written so after every chunk."""
    path, taken = folder / f".semlive-doctor-{os.getpid()}", []
    try:
        try:
            with path.open("xb", buffering=0) as file:
                for _ in range(times):
                    began = time.monotonic()
                    file.write(os.urandom(size))
                    os.fsync(file.fileno())
                    taken.append(time.monotonic() - began)
        finally:
            path.unlink(missing_ok=True)
    except OSError as error:
        return Finding(
            "log folder", f"{folder} may not be written ({error.strerror})", Verdict.FAILED, "correct run.folder or its permissions"
        )
    worst_s = max(taken)
    said = f"1 MB is kept within {1e3 * worst_s:.0f} ms ({folder})"
    if worst_s < 0.2:
        return Finding("log folder", said, Verdict.OK)
    slow = "log to a disk of this computer, not to a share or a memory stick; copy afterwards"
    return Finding("log folder", said, Verdict.UNKNOWN if worst_s < 2.0 else Verdict.FAILED, slow)


def _adjtimex() -> tuple[bool, float] | None:
    """Whether the kernel's clock is synchronised, and by how much it may be wrong at most (s)."""
    try:
        call = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError):
        return None
    told = (ctypes.c_long * 64)()  # struct timex: modes, offset, freq, maxerror, esterror, status, ...; modes 0 only reads
    if call(told) < 0:
        return None
    return not told[5] & 0xFFFFFFFF & _STA_UNSYNC, told[3] * 1e-6


def _said(command: list[str]) -> str | None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
