"""A pair is correlated where a service may write nothing but its own folders: a read-only installation, no home."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from bench_sandbox import command, pair
from numba.core.caching import UserProvidedCacheLocator

from semlive.service.runtime.jit_cache import KERNELS

pytestmark = pytest.mark.checkout


@pytest.fixture
def namespace_peer() -> str:
    found = shutil.which("unshare")
    if found is None or subprocess.run([found, "--mount", "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("no mount namespace for this user")
    return found


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """The service's own folder, with what was compiled before: compiling again takes half a minute (bench_sandbox.py does it)."""
    for compiled in KERNELS.rglob("__pycache__"):
        below = UserProvidedCacheLocator.get_suitable_cache_subpath(str(compiled.with_name("kernel.py")))
        shutil.copytree(compiled, tmp_path / "jit" / below, ignore=shutil.ignore_patterns("*.pyc"))
    return tmp_path


def test_a_pair_is_correlated_in_the_sandbox(namespace_peer: str, state: Path) -> None:
    work = [sys.executable, "-m", "semlive", "dic", *pair(state), "--step", "20", "--json"]
    entered, environ = command(state, work)
    done = subprocess.run(entered, env=environ, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    reported = json.loads(done.stdout)
    assert reported["converged"] == reported["points"] > 100
    # What is not writable cannot have been used: the installation's own folder of compiled functions is one of these.
    trial = ["sh", "-c", f"touch {KERNELS}/__pycache__/trial || echo refused"]
    entered, environ = command(state, trial)
    assert subprocess.run(entered, env=environ, capture_output=True, text=True, timeout=60, check=False).stdout == "refused\n"
