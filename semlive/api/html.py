"""An open log as a table, for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape


def table_html(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return a table of two columns; all text is escaped."""
    lines = "".join(f"<tr><th style='text-align:left'>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    return f"<table><caption style='text-align:left'><b>{escape(title)}</b></caption>{lines}</table>"


def constant_rows(constants: Mapping[str, float]) -> Iterable[tuple[str, str]]:
    """Yield elastic constants with their standard uncertainties."""
    for name, label, unit in (("youngs_modulus_gpa", "Young's modulus", " GPa"), ("poissons_ratio", "Poisson's ratio", "")):
        if name in constants:
            yield label, f"{constants[name]:.4g} ± {constants[f'{name}_sigma']:.2g}{unit}"
