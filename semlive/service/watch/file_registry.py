"""Registry of processed exported files in records of fixed size.

As Python objects a file needed 0.6 kB, and a SEM that scans continuously exports 10,000 files in a week.
"""

from __future__ import annotations

import hashlib
import os
import struct
from array import array
from dataclasses import dataclass

INITIAL_CAPACITY = 32_768  # files, 5.2 MB, which is 22 days of a scan a minute; the capacity doubles when it is used up
PREEXISTING, DUPLICATE = -1, -2
"""Values instead of the number of an export: the file existed before the run, or was refused as a copy."""

# Digest of the name, size, modification time, change time, export, whether it was overwritten, SHA-256, as much of the name as fits.
_RECORD = struct.Struct("<16s qqq q ? 32s 63s")
_NAME, _STATE, _SHA256 = slice(0, 16), slice(16, 40), slice(49, 81)
_PACKED_STATE = struct.Struct("<qqq")
_NO_SHA256 = bytes(32)

State = tuple[int, int, int]
"""Size, modification time and change time."""


@dataclass(frozen=True, slots=True)
class RegisteredFile:
    """A processed file.

    Attributes:
        state: size and times at the last scan.
        export: its number, `PREEXISTING` or `DUPLICATE`.
        sha256: digest of the accepted bytes; empty if none were accepted.
        overwritten: its present content differs from the accepted bytes.
    """

    state: State
    export: int
    sha256: str = ""
    overwritten: bool = False

    @property
    def description(self) -> str:
        """Return the decision about the file, a clause."""
        if self.export >= 0:
            return f"was taken as export {self.export}"
        return "was refused as a copy" if self.export == DUPLICATE else "was there before the run"


class FileRegistry:
    """Processed files by name and by content.

    All memory is allocated at once, so that it does not grow while the registry is filled.

    Args:
        room: initial capacity in files, a power of two.
    """

    def __init__(self, room: int = INITIAL_CAPACITY) -> None:
        self._room, self._count = room, 0
        self._records = bytearray(b"\xff") * (room * _RECORD.size)
        self._by_name, self._by_sha256 = _places(room), _places(room)

    def __len__(self) -> int:
        return self._count

    @property
    def nbytes(self) -> int:
        """Return the memory of the registry, bytes."""
        return len(self._records) + sum(table.itemsize * len(table) for table in (self._by_name, self._by_sha256))

    def is_unchanged(self, name: str, state: State) -> bool | None:
        """Whether a file is unchanged; None if it is not registered. Called for every file at every scan: 2 us."""
        number = self._by_name[self._place(self._by_name, _NAME, _digest(name))]
        if not number:
            return None
        begin = (number - 1) * _RECORD.size
        return self._records[begin + _STATE.start : begin + _STATE.stop] == _PACKED_STATE.pack(*state)

    def get(self, name: str) -> RegisteredFile | None:
        """Return the record of a name, or None."""
        number = self._by_name[self._place(self._by_name, _NAME, _digest(name))]
        if not number:
            return None
        _, size, mtime_ns, ctime_ns, export, overwritten, sha256, _ = _RECORD.unpack_from(self._records, (number - 1) * _RECORD.size)
        digest = "" if sha256 == _NO_SHA256 else sha256.hex()
        return RegisteredFile((size, mtime_ns, ctime_ns), export, digest, overwritten)

    def put(self, name: str, file: RegisteredFile) -> None:
        """Register a file or replace its record; its content stays registered too."""
        digest, sha256 = _digest(name), bytes.fromhex(file.sha256) or _NO_SHA256
        place = self._place(self._by_name, _NAME, digest)
        number = self._by_name[place]
        if not number:
            if self._count == self._room:
                self._grow()
                place = self._place(self._by_name, _NAME, digest)
            self._count = number = self._count + 1
            self._by_name[place] = number
        shown, at = name.encode("utf-8", "backslashreplace"), (number - 1) * _RECORD.size
        _RECORD.pack_into(self._records, at, digest, *file.state, file.export, file.overwritten, sha256, shown)
        if sha256 != _NO_SHA256:
            place = self._place(self._by_sha256, _SHA256, sha256)
            self._by_sha256[place] = self._by_sha256[place] or number

    def same_content(self, sha256: str) -> str | None:
        """Return the name of the accepted file with the same bytes, if it is still registered."""
        number = self._by_sha256[self._place(self._by_sha256, _SHA256, bytes.fromhex(sha256))]
        if not number:
            return None
        shown: bytes = _RECORD.unpack_from(self._records, (number - 1) * _RECORD.size)[-1]
        return shown.rstrip(b"\0").decode("utf-8", "ignore")

    def _place(self, places: array[int], part: slice, content: bytes) -> int:
        """Return the place in a hash table of the record with this part, or the free place for it."""
        records, size, last = self._records, _RECORD.size, len(places) - 1
        place = int.from_bytes(content[:8], "little") & last
        while number := places[place]:
            begin = (number - 1) * size
            if records[begin + part.start : begin + part.stop] == content:
                break
            place = (place + 1) & last
        return place

    def _grow(self) -> None:
        self._records += bytearray(b"\xff") * len(self._records)
        self._room *= 2
        self._by_name, self._by_sha256 = _places(self._room), _places(self._room)
        for number in range(1, self._count + 1):
            begin = (number - 1) * _RECORD.size
            for places, part in ((self._by_name, _NAME), (self._by_sha256, _SHA256)):
                key = bytes(self._records[begin + part.start : begin + part.stop])
                if key != _NO_SHA256:
                    place = self._place(places, part, key)
                    places[place] = places[place] or number


def _places(room: int) -> array[int]:
    """Return an empty hash table of record numbers, counted from 1; it is at most half full."""
    return array("I", b"\0" * (2 * room * array("I").itemsize))


def _digest(name: str) -> bytes:
    return hashlib.blake2b(os.fsencode(name), digest_size=16).digest()
