"""Notebooks of the documentation: their code runs on a log, and they are stored without outputs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from run_notebook import run_notebook

NOTEBOOKS = sorted((Path(__file__).parents[3] / "docs" / "examples").glob("*.ipynb"))
pytestmark = pytest.mark.checkout


def cells(path: Path) -> list[dict[str, Any]]:
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


def test_there_is_one() -> None:
    assert [path.name for path in NOTEBOOKS] == ["analyse_a_log.ipynb"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_has_the_form_of_version_4_5_without_outputs(path: Path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)


def test_the_code_runs_and_shows_tables_and_figures(imported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SEMLIVE_LOG", "")  # restored after the test
    names, shown = run_notebook(NOTEBOOKS[0], imported)
    assert "tension.mcap" in shown[0]._repr_html_()
    assert shown[1]["load_n"].iloc[-1] == pytest.approx(213.3)
    assert shown[3]["youngs_modulus_gpa"] == pytest.approx(71.1, abs=4 * shown[3]["youngs_modulus_gpa_sigma"])
    assert len(pd.read_csv(tmp_path / "frame.csv")) == names["last"].valid.sum()
    assert (tmp_path / "stress_strain.pdf").read_bytes().startswith(b"%PDF")
