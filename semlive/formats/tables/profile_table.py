"""Table of the displacement at the start of rows (or frames) at several pixel sizes and scan speeds.

| column | meaning |
|---|---|
| ``pixel_nm`` | pixel size, nm |
| ``pixel_s`` | time from pixel to pixel along the profile, s: the dwell time along rows, the row time along columns |
| ``distance_px`` | distance from the start, px |
| ``shift_px`` | displacement, px |
| ``sigma_px`` | its standard uncertainty, px |

Lines with equal pixel size and time form one profile.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadInput
from semlive.inputs.text_table import TITLE_LINES, Column, is_blank, key_of, layout_of, lines_of, number_in, text_of

COLUMNS = ("pixel_nm", "pixel_s", "distance_px", "shift_px", "sigma_px")
POSITIVE = ("pixel_nm", "pixel_s", "sigma_px")
MIN_POINTS = 8  # of a profile; two exponentials and a constant have five parameters


def read_profile_table(data: bytes, where: str) -> dict[tuple[float, float], NDArray[np.float64]]:
    """Read the profiles, (n, 3) distance, displacement and uncertainty of each (pixel size, time per pixel), in the order of the file.

    Args:
        data: bytes of the file.
        where: name of the file, for errors.

    Raises:
        BadInput: the table is invalid; the message contains file, line, column and advice.
    """
    lines = lines_of(text_of(data, where))
    layout = layout_of(lines, where, _places, searched=TITLE_LINES)
    keys = [key_of(column.raw) for column in layout.columns]
    at = {name: keys.index(key_of(name)) for name in COLUMNS}
    profiles: dict[tuple[float, float], list[tuple[float, ...]]] = {}
    for number, line in enumerate(lines[layout.first_line - 1 :], layout.first_line):
        if not is_blank(line):
            cells = layout.cells(line, number)
            layout = layout.after(cells)
            values = {
                name: _number(cells[place], name, f"{where}: line {number}, column {name}", layout.decimal) for name, place in at.items()
            }
            profiles.setdefault((values["pixel_nm"], values["pixel_s"]), []).append(tuple(values[name] for name in COLUMNS[2:]))
    if not profiles:
        raise BadInput(f"{where}: line {layout.first_line}: holds no point; write one line for each point of a profile.")
    for (pixel_nm, pixel_s), points in profiles.items():
        if len(points) < MIN_POINTS:
            raise BadInput(
                f"{where}: the profile of {pixel_nm:g} nm and {pixel_s:g} s has {len(points)} points; give at least {MIN_POINTS} of each."
            )
    return {setting: np.array(points) for setting, points in profiles.items()}


def _places(columns: tuple[Column, ...]) -> tuple[int, ...]:
    keys = [key_of(column.raw) for column in columns]
    for name in COLUMNS:
        if keys.count(key_of(name)) != 1:
            problem = "is missing" if key_of(name) not in keys else "occurs twice"
            raise BadInput(f"{{head}}: column {name} {problem}; the columns are {', '.join(COLUMNS)}.")
    return tuple(keys.index(key_of(name)) for name in COLUMNS)


def _number(cell: str, name: str, place: str, decimal: str) -> float:
    value = number_in(cell, decimal)
    if value is None or not math.isfinite(value):
        raise BadInput(f"{place}: {cell[:40]!r} is not a number; write a number with a decimal point, and none between thousands.")
    if name in POSITIVE and value <= 0.0:
        raise BadInput(f"{place}: is {value:g}; give a value above 0.")
    return value
