"""Run the code of a notebook on a log, in this process: ``python tests/benchmarks/run_notebook.py NOTEBOOK LOG``."""

from __future__ import annotations

import ast
import json
import os
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt


def run_notebook(path: Path, log: Path) -> tuple[dict[str, Any], list[Any]]:
    """Run each cell as Jupyter does: statements, then the value of a last expression.

    Args:
        path: notebook; files that it writes are made in the current folder.
        log: log that it opens, by ``SEMLIVE_LOG``.

    Returns:
        The names after the last cell, and the value of each cell with code, None where it ends with a statement.
    """
    mpl.use("Agg")
    os.environ["SEMLIVE_LOG"] = str(log)
    names: dict[str, Any] = {"__name__": "__main__"}
    shown: list[Any] = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            parsed = ast.parse("".join(cell["source"]))
            last = parsed.body.pop() if isinstance(parsed.body[-1], ast.Expr) else None
            exec(compile(parsed, cell["id"], "exec"), names)
            shown.append(eval(compile(ast.Expression(last.value), cell["id"], "eval"), names) if isinstance(last, ast.Expr) else None)
    plt.close("all")
    return names, shown


if __name__ == "__main__":
    for value in run_notebook(Path(sys.argv[1]), Path(sys.argv[2]))[1]:
        sys.stdout.write(f"{value!r}\n")
