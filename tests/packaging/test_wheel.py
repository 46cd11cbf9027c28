"""The wheel holds the three packages completely, and nothing else."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = {
    "semlive": ROOT / "semlive",
    "semlive_drivers": ROOT / "drivers/semlive_drivers",
    "semlive_simulators": ROOT / "simulators/semlive_simulators",
}

pytestmark = pytest.mark.checkout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The names of the files in a wheel built from the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    built = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert built.returncode == 0, built.stdout + built.stderr
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path).namelist()


def test_the_wheel_holds_exactly_the_three_packages(wheel: list[str]) -> None:
    tops = {name.split("/")[0] for name in wheel}
    info = {top for top in tops if top.endswith(".dist-info")}
    assert len(info) == 1
    assert tops - info == set(SOURCES)


@pytest.mark.parametrize("package", SOURCES)
def test_every_file_of_a_package_is_in_the_wheel(wheel: list[str], package: str) -> None:
    source = SOURCES[package]
    files = {path.relative_to(source) for path in source.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert files
    assert {name for name in wheel if name.startswith(f"{package}/")} == {f"{package}/{path.as_posix()}" for path in files}


@pytest.mark.parametrize("package", SOURCES)
def test_type_checkers_use_the_annotations_of_a_package(wheel: list[str], package: str) -> None:
    assert f"{package}/py.typed" in wheel


def test_the_wheel_carries_its_licence_and_commands(wheel: list[str]) -> None:
    files = {name.split(".dist-info/")[1] for name in wheel if ".dist-info/" in name}
    assert {"METADATA", "entry_points.txt", "licenses/LICENSE"} <= files
