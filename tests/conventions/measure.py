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
    words = Counter(word.lower() for node in nodes for name in names(node) for word in _WORD.findall(name))
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
        "banned words in identifiers": f"{sum(words[word] for word in BANNED)}",
    }


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
