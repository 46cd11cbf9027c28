"""Marks of points in disparity maps as texts or numbers, for marks of known and of unknown sense.

A ``mask`` is 1 where a point was found (Ncorr) or where it is masked out (numpy), and numbers in ``status`` or ``flags`` differ between
programs. Such a mark is used only if the points themselves show which of its values means that a point was not found.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import PoiStatus
from semlive.inputs.text_number import number_in

VALID, INVALID = "valid", "invalid"
SPELLINGS = {
    **dict.fromkeys(("isvalid", "validity", "found", "isfound", "converged", "isconverged", "gültig", "valide"), VALID),
    **dict.fromkeys(("isinvalid", "masked", "ismasked", "lost", "islost", "ungültig", "outlier", "isoutlier"), INVALID),
}
"""Other names of columns that state which points were found, or not found."""
UNKNOWN_SENSE = ("mask", "status", "flag", "flags", "vectortype")
"""Names of columns whose values may mean either."""
TEXT_MARKS = (VALID, INVALID, "converged", *UNKNOWN_SENSE)
"""Columns of marks that may be texts."""
_FOUND = "true yes y t on ok good valid found ja wahr oui vrai sí si vero sim はい"
_NOT_FOUND = "false no n f off nok bad invalid lost failed masked nein falsch non faux falso não いいえ"
_TEXTS = {
    **dict.fromkeys(_FOUND.split(), 1.0),
    **dict.fromkeys(_NOT_FOUND.split(), 0.0),
    **{status.label: float(status is PoiStatus.CONVERGED) for status in PoiStatus},
}


def mark_in(cell: str, decimal: str) -> float | None:
    """Return a mark as a number, 1 for ``true`` and 0 for ``false``; NaN for a lost value, None for other texts."""
    mark = _TEXTS.get(cell.casefold())
    return number_in(cell, decimal) if mark is None else mark


def points_found(name: str, marks: NDArray[np.float64], min_mark: float, lost: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Return which points were found.

    Args:
        name: the column of marks.
        marks: (n,) marks.
        min_mark: smallest mark of a point that was found; NaN if the sense of the column is unknown.
        lost: (n,) points without displacement, which were not found in any case.

    Returns:
        (n,) whether the point was found; None if the marks have several values that may mean either.
    """
    if name == INVALID:
        return marks < 0.5
    if not math.isnan(min_mark):
        return marks >= min_mark
    values = np.unique(marks[~np.isnan(marks)])
    not_found = [value for value in values if lost[marks == value].all()]
    if len(values) > 1 and len(values) - len(not_found) != 1:
        return None
    return ~np.isin(marks, not_found) if len(values) > 1 else np.ones(len(marks), dtype=np.bool_)
