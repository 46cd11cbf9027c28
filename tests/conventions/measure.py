"""Size and language of the code: `python tests/conventions/measure.py [ROOT...]` prints one column for each checkout.

Identifiers are split at underscores and capitals; a term is banned if the naming rules in CONTRIBUTING replace it.
"""

from __future__ import annotations

import ast
import re
import statistics
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

PRODUCT = ("semlive", "drivers", "simulators")
BANNED = frozenset(
    {
        *("told", "tell", "said", "say", "known", "left", "seen", "asked", "begun", "kept", "heard", "hear", "voice", "beside"),
        *("among", "apart", "alike", "having", "bare", "foreseen", "foretold", "loud", "quiet", "story", "eaten", "mend"),
        *("anew", "lately", "wanted", "knock", "desk"),
    }
)
CONTRACT_NAMES: frozenset[str] = frozenset({"say", "heard", "tell", "RATE_NOT_KEPT", "sutton_phases_apart"})
"""Identifiers that other programs rely on: keys of JSON, of logs and of the configuration, methods of Python files."""
CONTRACT_FIELDS = {
    "semlive/web/page_state.py": {"wanted", "told", "desk"},
    "tests/benchmarks/peer_frame/scenario.py": {"said", "asked"},
}
"""Identifiers of one module that are keys of the JSON which the live page reads, or of stored observations."""
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def figures(root: Path) -> dict[str, str]:
    """The figures of one checkout, by name."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for name in PRODUCT for path in sorted((root / name).rglob("*.py"))}
    sizes = sorted(_lines(path) for path in trees)
    folders = Counter(path.parent for path in trees)
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    functions = [node for node in nodes if isinstance(node, _FUNCTIONS)]
    classes = [node for node in nodes if isinstance(node, ast.ClassDef)]
    words = Counter(_use(path.relative_to(root).as_posix(), name) for path, tree in trees.items() for name in _banned_names(tree))
    return {
        "modules": f"{len(sizes)}",
        "lines of product": f"{sum(sizes)}",
        "lines of tests": f"{sum(_lines(path) for path in (root / 'tests').rglob('*.py'))}",
        "median module, lines": f"{statistics.median(sizes):.0f}",
        "90th percentile, lines": f"{sizes[int(0.9 * len(sizes))]}",
        "longest module, lines": f"{sizes[-1]}",
        "functions and methods": f"{len(functions)}",
        "longest function, lines": f"{max((node.end_lineno or 0) - node.lineno + 1 for node in functions)}",
        "most methods in a class": f"{max(sum(isinstance(item, _FUNCTIONS) for item in node.body) for node in classes)}",
        "most fields in a class": f"{max(sum(isinstance(item, ast.AnnAssign) for item in node.body) for node in classes)}",
        "uses of Any": f"{sum(isinstance(node, ast.Name) and node.id == 'Any' for node in nodes)}",
        "folders with more than 15 modules": f"{sum(count > 15 for count in folders.values())}",
        "most modules in a folder": f"{max(folders.values())}",
        "banned words in identifiers": f"{words['banned']}",
        "contract words in identifiers": f"{words['contract']}",
        "identifiers of the left side": f"{words['direction']}",
    }


def banned_words(name: str) -> set[str]:
    """Banned words of an identifier."""
    return {word.lower() for word in _WORD.findall(name)} & BANNED


def _banned_names(tree: ast.AST) -> Iterator[str]:
    return (name for node in ast.walk(tree) for name in names(node) if banned_words(name))


def _use(place: str, name: str) -> str:
    """Reason for a banned word in an identifier of a module: contract, direction, or none. What is residual is not named *left*."""
    if name in CONTRACT_NAMES or name in CONTRACT_FIELDS.get(place, set[str]()):
        return "contract"
    return "direction" if banned_words(name) == {"left"} else "banned"


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def names(node: ast.AST) -> Iterator[str]:
    """Names that a node introduces."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.arg):
        yield node.arg
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        yield node.id


def main() -> None:
    """Print the table."""
    roots = [Path(name) for name in sys.argv[1:]] or [Path(__file__).parents[2]]
    columns = [figures(root) for root in roots]
    for name in columns[0]:
        sys.stdout.write(f"{name:<36}" + "".join(f"{column[name]:>12}" for column in columns) + "\n")


if __name__ == "__main__":
    main()
