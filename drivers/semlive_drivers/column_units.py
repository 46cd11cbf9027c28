"""Units of the columns of a load file: from the settings, the head, a name, a title, or the cell next to a number."""

from __future__ import annotations

import re
from collections.abc import Sequence

from semlive.errors import BadInput
from semlive.inputs.text_table import Column, number_in
from semlive_drivers.units import factor, unit_in_name, unit_named

KINDS = {
    "force": ("N", "kN", "mN", "uN", "daN", "kg", "g", "t", "lbF"),
    "extension": ("mm", "um", "m", "in"),
    "gage": ("ustrain", "%", "1"),
}
"""Units of each kind of readings; a file that states none is in N, mm or strain."""
_OTHER_UNIT_OF_GAGE = re.compile(r"mV/V|‰", re.IGNORECASE)


def unit_factor(kind: str, stated: str | None, head: Column) -> float:
    """N, mm or strain of one unit of a column.

    Args:
        kind: force, extension or gage.
        stated: unit in the settings; None without.
        head: column in the head of the file.

    Raises:
        BadInput: if its unit is unknown, differs from the settings, or may be another one.
    """
    head_unit = unit_named(head.unit)
    if head_unit and head_unit not in KINDS[kind]:
        raise BadInput(f"{{head}}: column {head.raw!r} is in {head.unit}, which is no unit of {kind}; check columns and delimiter.")
    if stated is None:
        if head.unit and not head_unit:
            units = ", ".join(KINDS[kind])
            raise BadInput(
                f"{{head}}: column {head.raw!r} is in {head.unit!r}, which is not known; state its unit in the settings ({units})."
            )
        _check_unit_elsewhere(kind, head, head_unit)
        return factor(head_unit or "1", "csv column")
    if head_unit and stated != "1" and factor(stated, "csv column") != factor(head_unit, "csv column"):
        raise BadInput(f"{{head}}: column {head.raw!r} is in {head.unit}, but the settings state {stated}; correct one of them.")
    return factor(stated, "csv column")


def _check_unit_elsewhere(kind: str, head: Column, head_unit: str) -> None:
    """Refuse a column that may have another unit than N, mm or 1, by a part of its name or by a line above the names.

    ``Force (t)`` may be in tonnes or depend on time.

    Raises:
        BadInput: if there is such a unit.
    """
    units, default = KINDS[kind], {"force": "N", "extension": "mm"}.get(kind, "1")
    named = "t" if head_unit == "t" else "" if head.unit else unit_in_name(head.raw)
    if named.casefold() == "mn" or unit_named(named) in set(units) - {default}:
        raise BadInput(f"{{head}}: column {head.raw!r} may be in {named!r}; state its unit in the settings ({', '.join(units)}).")
    if kind == "gage" and not head.unit and _OTHER_UNIT_OF_GAGE.search(head.raw):
        raise BadInput(
            f"{{head}}: column {head.raw!r} is no strain; record strain, and state its unit in the settings ({', '.join(units)})."
        )
    for line, unit in head.title_units:
        if unit_named(unit) in set(units) - {default}:
            raise BadInput(f"{{head}}: column {head.raw!r} has no unit, but line {line} states {unit!r}; state its unit in the settings.")


def unit_next_to(cells: Sequence[str], index: int) -> str:
    """The unit in the cell behind a number, or else before it, as force gauges send it; empty without one."""
    neighbours = (*cells[index + 1 : index + 2], *cells[max(0, index - 1) : index])
    return next((unit for cell in neighbours if (unit := unit_named(cell)) and not number_in(cell, ".")), "")
