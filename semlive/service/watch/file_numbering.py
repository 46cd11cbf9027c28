"""Numbers in the names of exported files: SEM programs count up, and gaps or restarts are reported."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

_NUMBERED = re.compile(r"(.*?)(\d{1,9})(\D{0,12})")

_MAX_KINDS = 100  # names that contain the time are of a new kind every minute


@dataclass(slots=True)
class FileNumbering:
    """The newest number of each kind of name, of the kinds that came last."""

    _newest: dict[tuple[str, str], tuple[int, str]] = field(default_factory=dict)

    def check_gap(self, name: str) -> str | None:
        """Return a message about an unusual number in a file name, or None.

        Args:
            name: name of an accepted file.
        """
        match = _NUMBERED.fullmatch(name.rpartition(".")[0])
        if match is None:
            return None
        kind, number = (match[1], match[3]), int(match[2])
        previous = self._newest.get(kind)
        self._newest.pop(kind, None)
        self._newest[kind] = (number, name)  # the newest kind is the last entry
        if len(self._newest) > _MAX_KINDS:
            del self._newest[next(iter(self._newest))]
        if previous is None or number == previous[0] + 1:
            return None
        if number > previous[0]:
            missing = number - previous[0] - 1
            are = "numbers are" if missing > 1 else "number is"
            return f"{name} came after {previous[1]}: {missing} {are} missing in between; look for lost exports."
        return f"{name} came after {previous[1]}: the SEM's count of file names went back; order is that of arrival."
