"""Marks of points in disparity maps as texts or numbers, for marks of known and of unknown sense.

Of several columns of marks, each may mark a point as not found.

A ``mask`` is 1 where a point was found (Ncorr) or where it is masked out (numpy), and numbers in ``status`` or ``flags`` differ between
programs. Such a mark is used only if the points themselves show which of its values means that a point was not found.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import PoiStatus
from semlive.inputs.text_number import number_in

Values, Found = NDArray[np.float64], NDArray[np.bool_]
VALID, INVALID = "valid", "invalid"
FOUND_AT = {"vectortype": 1.0, "typevector": 1.0, "chc": 1.0, "returnstatus": 2.0}
"""Value of a point that was found: PIVlab (0 masked, 2 interpolated), TSI Insight (2 interpolated, below 1 not found), spam (1 no
convergence, below 1 other failures)."""
OPENPIV = ("flags", "mask")
"""Two columns that OpenPIV writes: 1 where a displacement was replaced by those around it, and where a point is masked out."""
CORRELATION = ("correlation", "correlationvalue", "correlationcoefficient", "corr", "corrcoeff", "corrcoef", "cc", "ncc", "zncc", "quality")
"""Columns whose zero next to zero displacement marks a point that was not found; texts in them are no marks."""
SPELLINGS = {
    **dict.fromkeys(
        ("isvalid", "validity", "found", "isfound", "converged", "isconverged", "gültig", "valide", "good", "isgood", "accepted"), VALID
    ),
    **dict.fromkeys(
        ("isinvalid", "masked", "ismasked", "lost", "islost", "ungültig", "outlier", "isoutlier", "missing", "excluded", "rejected", "bad"),
        INVALID,
    ),
}
"""Other names of columns that state which points were found, or not found."""
UNKNOWN_SENSE = ("mask", "status", "flag", "flags")
"""Names of columns whose values may mean either."""
MARKS = (VALID, INVALID, *UNKNOWN_SENSE, *FOUND_AT)
"""Columns that mark points that were found or not found."""
TEXT_MARKS = (VALID, INVALID, "converged", *UNKNOWN_SENSE)
"""Columns of marks that may be texts."""
_FOUND = "true yes y t on ok good valid found pass passed accepted ja wahr oui vrai sí si vero sim はい"
_NOT_FOUND = (
    "false no n f off nok bad invalid lost fail failed error rejected outlier masked missing diverged nein falsch non faux falso não いいえ"
)
_TEXTS = {
    **dict.fromkeys(_FOUND.split(), 1.0),
    **dict.fromkeys(_NOT_FOUND.split(), 0.0),
    **{status.label: float(status is PoiStatus.CONVERGED) for status in PoiStatus},
}


def mark_in(cell: str, decimal: str) -> float | None:
    """Return a mark as a number, 1 for ``true`` and 0 for ``false``; NaN for a lost value, None for other texts."""
    mark = _TEXTS.get(cell.casefold())
    return number_in(cell, decimal) if mark is None else mark


def points_found(name: str, marks: Values, min_mark: float, displacement: tuple[Values, Values], names: Collection[str]) -> Found | None:
    """Return which points a column marks as found.

    Args:
        name: the column of marks.
        marks: (n,) marks.
        min_mark: smallest mark of a point that was found; NaN if the sense of the column follows from its name.
        displacement: (n,) u and v; points without displacement, NaN or exactly 0, were not found in any case if the sense is unknown.
        names: all columns of marks.

    Returns:
        (n,) whether the point was found; None if the marks have several values that may mean either.
    """
    u, v = displacement
    zero = (u == 0) & (v == 0)
    if not math.isnan(min_mark):
        return marks >= min_mark
    if name == INVALID:
        return marks < 0.5
    if name == VALID:
        return marks >= 0.5
    if name in FOUND_AT:
        return marks == FOUND_AT[name]
    if name in CORRELATION:
        return ~(zero & ~(marks > 0))
    if name in OPENPIV and all(other in names for other in OPENPIV):
        return marks == 0
    lost = np.isnan(u) | np.isnan(v) | zero
    values = np.unique(marks[~np.isnan(marks)])
    not_found = [value for value in values if lost[marks == value].all()]
    if len(values) > 1 and len(values) - len(not_found) != 1:
        return None
    return ~np.isin(marks, not_found) if len(values) > 1 else np.ones(len(marks), dtype=np.bool_)
