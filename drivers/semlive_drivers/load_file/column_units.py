"""Units of the columns of a load file: from the settings, the head, a name, a title, or the cell next to a number."""

from __future__ import annotations

from collections.abc import Sequence

from semlive.errors import BadInput
from semlive.inputs.text_table import Column, UnclearUnit, number_in
from semlive_drivers.load_file.unit_words import factor_in_name, factor_in_text, is_unit_or_factor, other_in_name, other_in_titles
from semlive_drivers.units import factor, unit_in_name, unit_named

KINDS = {
    "force": ("N", "kN", "mN", "uN", "daN", "kg", "g", "t", "lbF"),
    "extension": ("mm", "um", "m", "in"),
    "gage": ("ustrain", "%", "1"),
}
"""Units of each kind of readings; a file that states none is in N, mm or strain."""
_UNIT_ABOVE = "{{head}}: {name} has no unit, but line {line} states {unit!r}; state its unit in the settings."
_DEFAULTS = {"force": "N", "extension": "mm", "gage": "1"}


def unit_factor(kind: str, stated: str | None, columns: Sequence[Column], index: int) -> float:
    """N, mm or strain of one unit of a column.

    Args:
        kind: force, extension or gage.
        stated: unit in the settings; None without.
        columns: columns in the head of the file.
        index: place of the column.

    Raises:
        BadInput: if its unit is unknown, differs from the settings, or may be another one.
    """
    head = columns[index]
    head_unit = unit_named(head.unit)
    if head_unit and head_unit not in KINDS[kind]:
        raise BadInput(f"{{head}}: column {head.raw!r} is in {head.unit}, which is no unit of {kind}; check columns and delimiter.")
    if stated is None:
        if head.unit and not head_unit:
            units = ", ".join(KINDS[kind])
            raise BadInput(
                f"{{head}}: column {head.raw!r} is in {head.unit!r}, which is not known; state its unit in the settings ({units})."
            )
        _check_unit_in_names(kind, head, head_unit, [column.raw for column in columns], index)
        _check_unit_in_titles(kind, head, index)
        return factor(head_unit or "1", "csv column")
    if head_unit and stated != "1" and factor(stated, "csv column") != factor(head_unit, "csv column"):
        raise BadInput(f"{{head}}: column {head.raw!r} is in {head.unit}, but the settings state {stated}; correct one of them.")
    return factor(stated, "csv column")


def _check_unit_in_names(kind: str, head: Column, head_unit: str, names: Sequence[str], index: int) -> None:
    """Refuse a column that may have another unit than N, mm or 1 by a part of its name, or by a unit between the names.

    ``Force (t)`` may be in tonnes or depend on time.

    Raises:
        BadInput: if there is such a unit.
    """
    units, default = KINDS[kind], _DEFAULTS[kind]
    not_default = set(units) - {default}
    named = "t" if head_unit == "t" else "" if head.unit else unit_in_name(head.raw)
    if named.casefold() != "mn" and unit_named(named) not in not_default:
        named = factor_in_name(head.raw) if head_unit else other_in_name(kind, head.raw)
    if named:
        raise BadInput(f"{{head}}: column {head.raw!r} may be in {named!r}; state its unit in the settings ({', '.join(units)}).")
    next_name = names[index + 1] if index + 1 < len(names) else ""
    if not is_unit_or_factor(kind, next_name):
        next_name = factor_in_text(kind, (head.raw,), " ".join(names))
    if not head.unit and head.raw and next_name:
        raise BadInput(f"{{head}}: {next_name!r} between the names may be the unit of column {head.raw!r}; state its unit in the settings.")


def _check_unit_in_titles(kind: str, head: Column, index: int) -> None:
    """Refuse a column without a unit below a line that states another unit than N, mm or 1.

    Raises:
        UnclearUnit: if there is such a line.
    """
    if head.unit:
        return
    name = f"column {head.raw!r}" if head.raw else f"column {index + 1}"
    line, unit = other_in_titles(kind, (head.raw, head.name), index + 1, head.titles)
    if line:
        raise UnclearUnit(_UNIT_ABOVE.format(name=name, line=line, unit=unit))
    for line, unit in head.title_units:
        if unit_named(unit) in set(KINDS[kind]) - {_DEFAULTS[kind]}:
            raise BadInput(_UNIT_ABOVE.format(name=name, line=line, unit=unit))


def unit_next_to(cells: Sequence[str], index: int) -> str:
    """The unit in the cell behind a number, or else before it, as force gauges send it; empty without one."""
    neighbours = (*cells[index + 1 : index + 2], *cells[max(0, index - 1) : index])
    return next((unit for cell in neighbours if (unit := unit_named(cell)) and not number_in(cell, ".")), "")
