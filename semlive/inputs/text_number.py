"""Cells of a text table: numbers with a given decimal sign, and lost values. Ambiguous cells are not numbers."""

from __future__ import annotations

import math
import re
from enum import Enum, auto

_NUMBER = {
    ".": re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?"),
    ",": re.compile(r"[+-]?(?:[0-9]+(?:,[0-9]+)?|,[0-9]+)(?:[eEdD][+-]?[0-9]+)?"),
}
_WHOLE = re.compile(r"[+-]?[0-9]+(?:[eEdD][+-]?[0-9]+)?")
_LIKE_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(?:(?:,[0-9]{3})+\.[0-9]*|(?:\.[0-9]{3})+,[0-9]*|(?:,[0-9]{3}){2,}|(?:\.[0-9]{3}){2,})")
SPREADSHEET_MARK = r"#(?:(?:n/?a|nv|n/[bd]|н/д)(?!\w)|(?:value|ref|name|num|null|div/0)[!?]|(?-i:[¡¿]?[^\W\d_a-zß-ÿа-я]+(?:/0)?[!?]))"
"""Error values of spreadsheets in any language: ``#N/A``, ``#NV``, ``#NUM!``, ``#BEZUG!``, ``#¡DIV/0!``, ``#NOM?``."""
_LOST = re.compile(
    r"[+-]?nan[0-9]*(?:\s?\(\w*\))?|[+-]?1[.,]#(?:ind|qnan|snan|nan|j)[0-9]*|n/?a|n\.\s?a\.|k\.\s?a\.|<na>|nat|null|nil|none"
    r"|n\. def\.|neun"  # NaN of .NET in German and Spanish
    r"|#{2,}|\*{2,}"  # number too long for its column, in spreadsheets and in Fortran
    rf"|{SPREADSHEET_MARK}|[-\u2212\u2013\u2014]+|\.|\?+|",
    re.IGNORECASE,
)
_LOST_WORDS = re.compile(
    r"missing|lost|undef(?:ined)?|n\.?\s?d\.?|n/d|no\s?data|not found|invalid|failed|masked|void|empty|err(?:or)?"
    r"|\(null\)|\\n|\[\]|nan\+nani",  # of .NET, MySQL, JSON and MATLAB
    re.IGNORECASE,
)
"""Marks of lost values that may be names of columns as well, so they are marks in lines of numbers only."""
_MINUS = str.maketrans("\N{MINUS SIGN}\N{EN DASH}\N{FULLWIDTH HYPHEN-MINUS}", "---")
_FORTRAN_EXPONENT = str.maketrans("dD", "ee")
_INFINITE = re.compile(r"([+-]?)(?:inf|infinity|1[.,]#inf[0-9]*)", re.IGNORECASE)


class Sign(Enum):
    """Evidence of a cell about the decimal sign of its table."""

    NONE = auto()
    """No evidence: an integer, a lost value, text."""
    POINT = auto()
    COMMA = auto()
    POINT_OR_THOUSANDS = auto()
    """``1.500``: one and a half, or fifteen hundred."""
    COMMA_OR_THOUSANDS = auto()
    THOUSANDS = auto()
    """``1,234.5``: not a number with any decimal sign."""


def sign_of(cell: str) -> Sign:
    """Return the evidence of a cell about the decimal sign."""
    cell = cell.translate(_MINUS)
    if "." not in cell and "," not in cell:
        return Sign.NONE
    if _LIKE_THOUSANDS.fullmatch(cell):
        return Sign.POINT_OR_THOUSANDS if "." in cell else Sign.COMMA_OR_THOUSANDS
    if _THOUSANDS.fullmatch(cell):
        return Sign.THOUSANDS
    for character, sign in ((".", Sign.POINT), (",", Sign.COMMA)):
        if _NUMBER[character].fullmatch(cell):
            return sign
    return Sign.NONE


def is_lost(cell: str) -> bool:
    """Whether a cell marks a missing value: empty, ``nan``, ``-nan(ind)``, ``1.#QNAN``, ``#NUM!``, ``--`` and similar marks."""
    return _LOST.fullmatch(cell) is not None


def is_whole(cell: str) -> bool:
    """Whether a cell is a number without a decimal sign."""
    return _WHOLE.fullmatch(cell.translate(_MINUS)) is not None


def number_in(cell: str, decimal: str) -> float | None:
    """Return the number in a cell.

    Args:
        cell: text without blanks around it.
        decimal: ``.`` or ``,``; empty if it is not known yet, then only unambiguous cells are numbers.

    Returns:
        The number; NaN for a lost value; None for anything else, thousands separators included.
    """
    cell = cell.translate(_MINUS)
    if is_lost(cell) or _LOST_WORDS.fullmatch(cell):
        return math.nan
    infinite = _INFINITE.fullmatch(cell)
    if infinite is not None:
        return -math.inf if infinite[1] == "-" else math.inf
    if not decimal:
        decimal = {Sign.NONE: ".", Sign.POINT: ".", Sign.COMMA: ","}.get(sign_of(cell), "")
    if not decimal or not _NUMBER[decimal].fullmatch(cell):
        return None
    return float(cell.replace(",", ".").translate(_FORTRAN_EXPONENT))
