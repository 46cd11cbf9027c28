"""The numbers in the names of exported files: SEM programs count up, and what they skip or begin again is worth a word."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

_NUMBERED = re.compile(r"(.*?)(\d{1,9})(\D{0,12})")

_KINDS = 100  # names that tell the time are of a new kind every minute


@dataclass(slots=True)
class FileNumbering:
    """The newest number of each kind of name, of the kinds that came last."""

    _newest: dict[tuple[str, str], tuple[int, str]] = field(default_factory=dict)

    def check_gap(self, name: str) -> str | None:
        """What is unusual about a further name, or None.

        Args:
            name: of a file that was taken.
        """
        found = _NUMBERED.fullmatch(name.rpartition(".")[0])
        if found is None:
            return None
        kind, number = (found[1], found[3]), int(found[2])
        before = self._newest.get(kind)
        self._newest.pop(kind, None)
        self._newest[kind] = (number, name)  # the kind that came last stands last
        if len(self._newest) > _KINDS:
            del self._newest[next(iter(self._newest))]
        if before is None or number == before[0] + 1:
            return None
        if number > before[0]:
            missing = number - before[0] - 1
            are = "numbers are" if missing > 1 else "number is"
            return f"{name} came after {before[1]}: {missing} {are} missing in between; look for lost exports."
        return f"{name} came after {before[1]}: the SEM's count of file names went back; order is that of arrival."
