"""Texts about a qualification, for its report and for the terminal, which needs no Matplotlib."""

from __future__ import annotations

import numpy as np

from semlive.qualify.history import FigureHistory
from semlive.qualify.values import Figure, Qualification, SetupFigures

MICRO = 1e6
LIMIT_SOURCES = ("drift_rate", "distortion")
"""Quantities without which the list of limits is incomplete."""


def limiting_text(qualification: Qualification) -> str:
    """Which effect limits the strain, without and with correction."""
    remedies = {limit.name: limit.remedy for limit in qualification.limits}
    if not qualification.limiting:
        return "The frames do not determine what limits the strain."
    missing = [item.name for item in qualification.undetermined if item.name in LIMIT_SOURCES]
    part = f" (without {' and '.join(missing)}, which these frames do not determine)".replace("_", " ") if missing else ""
    named = [("Without correction", qualification.limiting), ("With the corrections of semlive", qualification.limiting_corrected)]
    return " ".join(f"{when}, {name.replace('_', ' ')} limits the strain{part}: {remedies[name]}." for when, name in named)


def setup_text(setup: SetupFigures) -> str:
    """Settings of further pairs."""
    size = f"pixels of {setup.pixel_nm:.4g} nm, " if setup.pixel_nm else ""
    rows = f"{setup.height_px} rows, " if setup.height_px else ""
    return f"{setup.pairs} pairs, {rows}{size}scan turned by {setup.rotation_deg:.3g} deg, dwell time {MICRO * setup.dwell_s:.3g} us"


def figure_text(figure: Figure) -> tuple[str, str]:
    """Value and 95 % interval of a figure, as texts with the digits that the interval allows."""
    half = 0.5 * (figure.high - figure.low)
    digits = 3 if half <= 0.0 else int(np.clip(np.ceil(np.log10(max(abs(figure.value), 1e-12) / half)) + 2, 2, 6))
    interval = f"{figure.low:.{digits}g} to {figure.high:.{digits}g}" if half > 0.0 else ""
    return f"{figure.value:.{digits}g}", interval


def change_text(history: FigureHistory) -> str:
    """One clause about the two newest values of a figure."""
    before, newest = (figure_text(figure)[0] for figure in history.figures[-2:])
    return f"{history.figures[-1].title} from {before} to {newest} {history.figures[-1].unit}".rstrip()
