"""Lines of disparity maps in files whose names are not in a line of names, and without the summary below the points."""

from __future__ import annotations

import re
from collections.abc import Sequence

from semlive.errors import BadInput
from semlive.formats.tables.disparity_columns import PIXELS, XYUV
from semlive.inputs.text_cells import is_line_of_numbers
from semlive.inputs.text_head import own_separator
from semlive.inputs.text_number import is_lost

_VECTOR_FILE = re.compile(r"#\s*(?:DaVis|nCorr)\b.*2D-vector", re.IGNORECASE)
_VARIABLES = re.compile(r"\s*(?:title\s*=\s*\"[^\"]*\"[\s,]*)?(?=variables\s*=)", re.IGNORECASE)
_AUXILIARY = re.compile(r"\s*DATASETAUXDATA\b.*", re.IGNORECASE)
_TECPLOT = re.compile(r"\s*[A-Z]+\s*(?:=|[A-Z]+\s*=)|\s*$", re.IGNORECASE)
_BLOCK = re.compile(r"=\s*\"?block", re.IGNORECASE)
_QUOTED = re.compile(r'"([^"]*)"')
_HEAD_LINES = 50
"""Lines in which ``VARIABLES =`` is searched."""
_FOOTER_LINES = 20
_FOOTER_REMARK = re.compile(r"\s*(?:%|!|//|\*{2}|[-=_*]{3,}[-=_*;,\s]*$)")
"""A remark or a line below the points; ``---;---`` may be lost values, and then has as many cells as a point."""


def map_lines(lines: list[str], where: str) -> list[str]:
    """Return the lines of a map with the names that a DaVis or Tecplot file states, without text below the points.

    Raises:
        BadInput: a DaVis file states another unit than pixels, or a Tecplot file has a block for each variable.
    """
    return _without_footer(_with_tecplot_names(_with_davis_names(lines, where), where))


def _with_davis_names(lines: list[str], where: str) -> list[str]:
    """Return the lines of a file that DaVis or a converter to its format wrote, with the names that its first line implies.

    Raises:
        BadInput: the first line states another unit than pixels.
    """
    if not lines or not _VECTOR_FILE.match(lines[0]):
        return lines
    for unit in _QUOTED.findall(lines[0])[1::2]:  # after each name its unit
        if unit.strip().casefold() not in PIXELS:
            raise BadInput(f"{where}: line 1: states the unit {unit[:20]!r}; export positions and displacements in pixels.")
    return ["# " + _separator(lines[1:2]).join(XYUV), *lines[1:]]


def _with_tecplot_names(lines: list[str], where: str) -> list[str]:
    """Return the lines of a Tecplot file with the names as a comment; its other lines above the points become blank.

    Raises:
        BadInput: the file lists all values of a variable after those of another.
    """
    at = next((place for place, line in enumerate(lines[:_HEAD_LINES]) if _VARIABLES.match(line)), None)
    if at is None:
        return lines
    stated = _AUXILIARY.sub("", _VARIABLES.sub("", lines[at], count=1))
    names, end = _QUOTED.findall(stated) or re.findall(r"[^\s,]+", stated.partition("=")[2]), at + 1
    while end < len(lines) and lines[end].lstrip().startswith('"'):  # one name on each line
        names, end = names + _QUOTED.findall(lines[end]), end + 1
    first = next((place for place in range(end, len(lines)) if not _TECPLOT.match(lines[place])), len(lines))
    if any(_BLOCK.search(line) for line in lines[end:first]):
        raise BadInput(f"{where}: line {first}: lists the values variable by variable (BLOCK); export one line for each point (POINT).")
    separator = _separator(lines[first : first + 1], len(names))
    head = "# " + separator.join(f'"{name}"' for name in names)
    return [*([""] * at), head, *([""] * (first - at - 1)), *lines[first:]] if names else lines


def _separator(lines: Sequence[str], cells: int = 0) -> str:
    """Return the separator of lines of numbers; a comma only if it separates so many cells, because it may be a decimal sign."""
    signs = [sign for sign in "\t;," if any(sign in line for line in lines)]
    return next((sign for sign in signs if sign != "," or all(line.count(",") == cells - 1 for line in lines)), " ")


def _without_footer(lines: list[str]) -> list[str]:
    """Return the lines without text below the points, such as ``Mean;;0.5;-0.2``, which begins with a letter where points do not."""
    end = len(lines)
    while end > max(0, len(lines) - _FOOTER_LINES) and _may_be_footer(lines[end - 1]):
        end -= 1
    is_footer = 0 < end < len(lines) and any(line.strip() for line in lines[end:])
    return [*lines[:end], ""] if is_footer and _is_point(lines[end - 1]) else lines


def _may_be_footer(line: str) -> bool:
    first, *others = _cells(line)
    is_point = sum(map(str.isdigit, (cell[-1:] for cell in others))) >= len(XYUV)
    return not line.strip() or _FOOTER_REMARK.match(line) is not None or (first[:1].isalpha() and not is_lost(first) and not is_point)


def _is_point(line: str) -> bool:
    cells = _cells(line)
    return len(cells) >= len(XYUV) and not cells[0][:1].isalpha() and is_line_of_numbers(cells)


def _cells(line: str) -> list[str]:
    separator = own_separator(line)
    return [cell.strip(' "') for cell in (line.split() if separator == " " else line.split(separator))] or [""]
