"""Rules of the code base, each tested over the complete tree and on a violation."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
import statistics
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import pytest

import semlive.data

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("semlive", "drivers", "simulators")
TEXT = {".py", ".md", ".toml", ".yaml", ".yml", ".svg", ".html", ".css", ".js", ".json", ".sh", ".txt", ".cfg", ".service", ".rules", ""}
SHELL_ROOMS = {
    *(
        "formats",
        "inputs",
        "ports",
        "process_lock",
        "endpoints",
        "errors",
        "service",
        "web",
        "report",
        "api",
        "cli",
        "pipeline",
        "qualify",
        "__main__",
    )
}

pytestmark = pytest.mark.checkout


@dataclass(frozen=True)
class Source:
    """A file of the tree: its path below the root (posix) and its text."""

    path: str
    text: str

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All nodes of the syntax tree."""
        return list(ast.walk(ast.parse(self.text)))

    @property
    def in_packages(self) -> bool:
        return self.path.split("/")[0] in PACKAGES


@cache
def tree_files() -> list[Source]:
    """Every text file of the tree, hidden folders and build products left out; read by the first test, not when tests are collected."""
    found = []
    for path in sorted(ROOT.rglob("*")):
        parts = path.relative_to(ROOT).parts
        excluded = any((part.startswith(".") and part != ".ci") or part in ("__pycache__", "dist", "build", "runs") for part in parts[:-1])
        if not excluded and path.is_file() and path.suffix in TEXT and path.name != ".git":  # a file in a work tree of git
            found.append(Source(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")))
    return found


def file_length(source: Source) -> Iterator[str]:
    lines = source.text.count("\n")
    if lines > 500:
        yield f"{source.path}: {lines} lines, 500 are allowed"


def function_length(source: Source) -> Iterator[str]:
    allowed = 120 if "kernels" in source.path.split("/") else 60
    for node in source.nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if lines > allowed:
                yield f"{source.path}:{node.lineno}: {node.name} has {lines} lines, {allowed} are allowed"


def public_methods(source: Source) -> Iterator[str]:
    for node in source.nodes:
        if isinstance(node, ast.ClassDef):
            methods = [m for m in node.body if isinstance(m, ast.FunctionDef | ast.AsyncFunctionDef) and not m.name.startswith("_")]
            if len(methods) > 12:
                yield f"{source.path}:{node.lineno}: {node.name} has {len(methods)} public methods, 12 are allowed"


def no_print(source: Source) -> Iterator[str]:
    if not source.in_packages or source.path.startswith("semlive/cli/"):
        return
    for node in source.nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
            yield f"{source.path}:{node.lineno}: print outside the command line"


def telling_names(source: Source) -> Iterator[str]:
    for part in Path(source.path).with_suffix("").parts:
        if part in {"util", "utils", "helper", "helpers", "misc", "common", "stuff"}:
            yield f"{source.path}: {part} has no meaning; name it for its job"


def no_mocks(source: Source) -> Iterator[str]:
    for node in source.nodes:
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
        module = (node.module or "") if isinstance(node, ast.ImportFrom) else ""
        if module.startswith("unittest") or any(name == "mock" or name.startswith("unittest") for name in names):
            yield f"{source.path}:{node.lineno}: fake at a seam, not with mocks"  # type: ignore[attr-defined]


def no_skips(source: Source) -> Iterator[str]:
    """Only the fixtures that find the sample images, or a peer that is not ours to bring, may skip."""
    allowed = {
        (inner.lineno, inner.col_offset)
        for node in source.nodes
        if isinstance(node, ast.FunctionDef) and re.search(r"samples|_peer$", node.name) and node.decorator_list
        for inner in ast.walk(node)
        if isinstance(inner, ast.Attribute)
    }
    for node in source.nodes:
        if isinstance(node, ast.Attribute) and node.attr in {"skip", "skipif", "xfail", "importorskip"}:
            owner = ast.unparse(node.value)
            if owner in {"pytest", "pytest.mark", "mark"} and (node.lineno, node.col_offset) not in allowed:
                yield f"{source.path}:{node.lineno}: {owner}.{node.attr}: a test that does not run shows nothing"


REGISTRIES = ("pypi", "pythonhosted", "npmjs", "debian", "crates", "golang")
PRIVATE = re.compile(r"(?<![\w.~-])/(?:work|root)/|/tmp/ba[s]h|" + r"\b(?:[\w-]+\.)*(?:" + "|".join(REGISTRIES) + r")\.(?:org|com|io)\b")


def public_text(source: Source) -> Iterator[str]:
    for number, line in enumerate(source.text.splitlines(), 1):
        if hit := PRIVATE.search(line):
            yield f"{source.path}:{number}: {hit.group()} belongs to one machine or one network"


Rule = Callable[[Source], Iterator[str]]
PYTHON_RULES: tuple[Rule, ...] = (file_length, function_length, public_methods, no_print, telling_names, no_mocks, no_skips)


@pytest.fixture(scope="module")
def broken_rules() -> dict[Rule, list[str]]:
    """The places that break each rule; every file is parsed once, and its syntax tree is not kept."""
    broken: dict[Rule, list[str]] = {rule: [] for rule in PYTHON_RULES}
    for source in (replace(source) for source in tree_files() if source.path.endswith(".py")):
        for rule, places in broken.items():
            places.extend(rule(source))
    return broken


@pytest.mark.parametrize("rule", PYTHON_RULES, ids=lambda rule: rule.__name__)
def test_python_keeps_the_rule(broken_rules: dict[Rule, list[str]], rule: Rule) -> None:
    assert not broken_rules[rule], "\n".join(broken_rules[rule])


def test_text_names_no_machine_and_no_registry() -> None:
    broken = [line for source in tree_files() for line in public_text(source)]
    assert not broken, "\n".join(broken)


@pytest.mark.parametrize(
    ("rule", "path", "text"),
    [
        (file_length, "semlive/a.py", "x = 1\n" * 501),
        (function_length, "semlive/a.py", "def f():\n" + "    x = 1\n" * 60),
        (function_length, "semlive/kernels/a.py", "def f():\n" + "    x = 1\n" * 120),
        (public_methods, "semlive/a.py", "class A:\n" + "".join(f"    def m{n}(self): ...\n" for n in range(13))),
        (no_print, "semlive/a.py", "print(1)\n"),
        (telling_names, "semlive/utils.py", ""),
        (telling_names, "semlive/helpers/a.py", ""),
        (no_mocks, "tests/a.py", "from unittest.mock import MagicMock\n"),
        (no_mocks, "tests/a.py", "from unittest import mock\n"),
        (no_mocks, "tests/a.py", "import unittest.mock\n"),
        (no_skips, "tests/a.py", "import pytest\n\n@pytest.mark.skip\ndef test_a(): ...\n"),
        (no_skips, "tests/a.py", "import pytest\n\ndef test_a():\n    pytest.skip('no')\n"),
        (public_text, "README.md", "see " + "/wo" + "rk/main\n"),
        (public_text, "README.md", "from https://py" + "pi.org/simple\n"),
    ],
)
def test_rule_bites(rule: Rule, path: str, text: str) -> None:
    assert list(rule(Source(path, text)))


@pytest.mark.parametrize(
    ("rule", "path", "text"),
    [
        (function_length, "semlive/a.py", "def f():\n" + "    x = 1\n" * 59),
        (function_length, "semlive/kernels/a.py", "def f():\n" + "    x = 1\n" * 119),
        (no_print, "semlive/cli/a.py", "print(1)\n"),
        (no_skips, "tests/conftest.py", "import pytest\n\n@pytest.fixture\ndef samples():\n    pytest.skip('no samples')\n"),
        (no_skips, "tests/conftest.py", "import pytest\n\n@pytest.fixture\ndef socat_peer():\n    pytest.skip('no socat')\n"),
        (public_text, "README.md", "frames/work/a.tif and https://example.org/\n"),
    ],
)
def test_rule_lets_pass(rule: Rule, path: str, text: str) -> None:
    assert not list(rule(Source(path, text)))


def test_modules_are_small() -> None:
    lengths = [source.text.count("\n") for source in tree_files() if source.in_packages and source.path.endswith(".py")]
    assert statistics.median(lengths) <= 150


def test_test_files_have_names_of_their_own() -> None:
    names = Counter(Path(source.path).name for source in tree_files() if re.match(r"tests/.*/?test_\w+\.py$", source.path))
    assert names
    assert not [name for name, times in names.items() if times > 1]


def test_source_roots_are_no_packages() -> None:
    assert not (ROOT / "drivers" / "__init__.py").exists()
    assert not (ROOT / "simulators" / "__init__.py").exists()


def test_every_package_is_pure_or_listed_as_shell() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    (pure,) = [contract["source_modules"] for contract in contracts if contract["id"] == "pure"]
    rooms = {module.name for module in pkgutil.iter_modules([str(ROOT / "semlive")])}
    assert rooms == {name.removeprefix("semlive.") for name in pure} | (SHELL_ROOMS & rooms)


def test_nouns_are_frozen_and_slotted() -> None:
    modules = [importlib.import_module(m.name) for m in pkgutil.walk_packages(semlive.data.__path__, "semlive.data.")]
    nouns = {
        item
        for module in modules
        for _, item in inspect.getmembers(module, inspect.isclass)
        if dataclasses.is_dataclass(item) and item.__module__ == module.__name__
    }
    assert len(nouns) > 20
    loose = [noun.__name__ for noun in nouns if not noun.__dataclass_params__.frozen or "__slots__" not in vars(noun)]
    assert not loose
