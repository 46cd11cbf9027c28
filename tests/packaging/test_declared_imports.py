"""Whatever is imported is declared: a fresh environment has what the packages need, and what the tests need."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OWN = {"semlive", "semlive_drivers", "semlive_simulators"}
PART_OF = {"pydantic-core": "pydantic"}  # pinned by its dependent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS = {"semlive": ("alerts", "dask", "pandas", "pdf", "xarray")}
"""Imported where they are used, with a clear error where they are not installed."""

pytestmark = pytest.mark.checkout


def named(requirements: list[str]) -> set[str]:
    return {canonical(re.split(r"[\[<>=~!; ]", requirement)[0]) for requirement in requirements}


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


distributions_by_module = cache(packages_distributions)
"""It reads the lists of files of all installed packages, in a second."""


@cache
def imported(folder: Path) -> set[str]:
    """The distributions whose modules are imported below a folder, but for the standard library and its own modules."""
    distributions = distributions_by_module()
    # The peers are run by interpreters of their own, in environments that the benchmark makes.
    paths = [path for path in folder.rglob("*.py") if path.parent.name != "peers"]
    neighbours = {path.stem for path in paths} | {path.parent.name for path in paths}
    found = set()
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
            tops = {name.split(".")[0] for name in names} - sys.stdlib_module_names - OWN - neighbours
            found |= {canonical(distributions.get(top, [top])[0]) for top in tops}
    return {PART_OF.get(name, name) for name in found}


@pytest.mark.parametrize("folder", ["semlive", "drivers", "simulators"])
def test_the_packages_declare_what_they_import(folder: str) -> None:
    extras = [item for extra in EXTRAS.get(folder, ()) for item in PROJECT["optional-dependencies"][extra]]
    assert imported(ROOT / folder) <= named(PROJECT["dependencies"] + extras)


def test_the_tests_declare_what_they_import() -> None:
    assert imported(ROOT / "tests") <= named(PROJECT["dependencies"] + PROJECT["optional-dependencies"]["test"])


def test_no_dependency_is_idle() -> None:
    assert named(PROJECT["dependencies"]) <= imported(ROOT / "semlive") | imported(ROOT / "drivers") | imported(ROOT / "simulators")
