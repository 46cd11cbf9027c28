"""A release: the same commit gives the same bytes, the wheel carries its bill of materials, workflow and container file are linted."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from sbom import ROOT, SBOM, text

WORKFLOW = ROOT / ".github" / "workflows" / "release.yml"
SOURCES = ("semlive", "drivers", "simulators", "deploy", "pyproject.toml", "README.md", "LICENSE", ".gitignore")

pytestmark = pytest.mark.checkout


def tool(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a linter of the environment."""
    return subprocess.run([Path(sys.executable).parent / name, *arguments], capture_output=True, text=True, timeout=60, check=False)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, str], dict[str, str], Path]:
    """SHA-256 of wheel and source distribution from two copies that differ in place, times and rights; a folder with them."""
    found, folder = [], tmp_path_factory.mktemp("built")
    for number, mode in enumerate((0o644, 0o600)):
        copy, out = folder / f"place-{number}" / "semlive", folder / f"out-{number}"
        copy.mkdir(parents=True)
        for name in SOURCES:
            source = ROOT / name
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, copy / name, ignore=ignored) if source.is_dir() else shutil.copy(source, copy / name)
        for path in copy.rglob("*"):
            if path.is_file():
                path.chmod(mode)
                time_s = 1_700_000_000 + 1000 * number
                os.utime(path, (time_s, time_s))
        build = [sys.executable, "-m", "hatchling", "build", "-d", str(out)]
        done = subprocess.run(build, cwd=copy, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        found.append({path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in out.iterdir()})
    return found[0], found[1], folder / "out-0"


def test_wheel_and_source_distribution_are_reproducible_to_the_byte(built: tuple[dict[str, str], dict[str, str], Path]) -> None:
    first, second, _ = built
    assert sorted(Path(name).suffix for name in first) == [".gz", ".whl"]
    assert first == second


def test_the_wheel_carries_its_bill_of_materials(built: tuple[dict[str, str], dict[str, str], Path]) -> None:
    (wheel,) = built[2].glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if ".dist-info/sboms/" in name]
        stored = archive.read(name).decode("utf-8")
    assert name.endswith("/semlive.cdx.json")
    assert stored == text()


def test_the_bill_is_that_of_the_repository() -> None:
    assert SBOM.read_text("utf-8") == text(), "run: python tests/packaging/sbom.py"
    components = {component["name"] for component in json.loads(text())["components"]}
    assert {"uplot", "numpy", "mcap"} <= components


def test_the_release_workflow_is_valid_and_safe() -> None:
    valid = tool("check-jsonschema", "--builtin-schema", "vendor.github-workflows", str(WORKFLOW))
    assert valid.returncode == 0, valid.stdout
    safe = tool("zizmor", "--offline", "--no-progress", str(WORKFLOW))
    assert safe.returncode == 0, safe.stdout


def test_the_container_file_has_no_finding() -> None:
    linted = tool("hadolint", str(ROOT / "deploy" / "Containerfile"))
    assert (linted.returncode, linted.stdout) == (0, "")
