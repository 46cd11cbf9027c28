"""A package of somebody else's adds a driver: built, installed next to semlive, found by its entry point, and held to the contract."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "semlive_example_frame"

pytestmark = pytest.mark.checkout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the example is installed."""
    target = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
    done = subprocess.run([*pip, "--target", str(target), str(EXAMPLE)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return {**os.environ, "PYTHONPATH": str(target)}


def test_its_driver_is_found_by_name(installed: dict[str, str]) -> None:
    code = "import time; from semlive.service.runtime.clock import open_clock; "
    code += "from semlive.service.runtime.drivers import open_load_frame as o\n"
    code += "from semlive_example_frame.machine import Machine\n"
    code += "frame = o('example_json', {'port': Machine().port}, open_clock(None)); print(frame.identity.name); frame.close()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=installed)
    assert done.stdout.startswith("example frame at 127.0.0.1:"), done.stderr


def test_it_keeps_the_contract_with_its_own_tests(installed: dict[str, str]) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib", str(EXAMPLE / "tests")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=installed, cwd=EXAMPLE)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "11 passed" in done.stdout
