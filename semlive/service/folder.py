"""The export folder as a state: which files are there, which are still being written, which have been taken.

No event means "complete": programs open a file several times, write it slowly, preallocate it, restore its modification time, and
shares send no events at all. So the folder is scanned, and a file is believed complete when its size and times have stood still
for a while, its structure is whole (`semlive.formats.check_complete`), and they still stand after it was read.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from semlive.data.frame import ExportedFile
from semlive.errors import BadConfig
from semlive.formats import check_complete
from semlive.ports import ClockSource

Key = tuple[int, int, int]
"""Size, modification time and file id."""


@dataclass(frozen=True, slots=True)
class WatchSettings:
    """What is watched, and when a file is believed complete.

    Attributes:
        folder: the SEM's export folder.
        poll_s: wall seconds between scans.
        stable_for_s: wall seconds for which size and times must stand still.
        stable_polls: scans for which they must stand still.
        give_up_after_s: a file that stands still for so long without becoming readable is refused.
        max_bytes: a larger file is refused unread; the log takes twice as much at once.
        suffixes: endings of image files, lower case; other files are not looked at.
        ignore_suffixes: endings of files that will be renamed when they are whole.
        adopt: take files that are there when the watch begins; otherwise they are none of this run.
        first_export: number of the first file taken.
    """

    folder: Path
    poll_s: float = 1.0
    stable_for_s: float = 2.0
    stable_polls: int = 2
    give_up_after_s: float = 30.0
    max_bytes: int = 2**28
    suffixes: tuple[str, ...] = (".tif", ".tiff", ".png")
    ignore_suffixes: tuple[str, ...] = (".tmp", ".temp", ".part", "~")
    adopt: bool = False
    first_export: int = 0


@dataclass(frozen=True, slots=True)
class FileRefused:
    """A file that is not taken, told once.

    Attributes:
        name: file name.
        reason: one sentence.
        size: bytes.
        mtime_ns: modification time, UTC ns.
        sha256: of its bytes; empty if they were not read.
        time_ns: experiment time of the refusal.
    """

    name: str
    reason: str
    size: int
    mtime_ns: int
    sha256: str
    time_ns: int


@dataclass(slots=True)
class _Candidate:
    """A file that may still be written to."""

    key: Key
    since_ns: int
    polls: int = 0
    look_again_ns: int = 0


@dataclass(slots=True)
class _Taken:
    """A file that is done with, as it was then, and when it last changed after that."""

    key: Key
    what: str
    changed_ns: int | None = None


@dataclass(slots=True)
class Folder:
    """Scans the export folder; call `poll` from one thread only.

    Attributes:
        settings: what is watched.
        clock: experiment time for arrivals, monotonic time for stability.
        on_file: given each complete file once, in order of modification time.
        on_refused: given each refused file once.
        on_trouble: told one sentence when the folder goes away and when it is back.
    """

    settings: WatchSettings
    clock: ClockSource
    on_file: Callable[[ExportedFile], None]
    on_refused: Callable[[FileRefused], None]
    on_trouble: Callable[[str], None]
    _candidates: dict[str, _Candidate] = field(default_factory=dict)
    _taken: dict[str, _Taken] = field(default_factory=dict)
    _given_up: dict[str, Key] = field(default_factory=dict)
    _hashes: dict[str, str] = field(default_factory=dict)
    _export: int = 0
    _gone: bool = False

    def open(self) -> None:
        """Look at the folder for the first time.

        Raises:
            BadConfig: it does not exist or cannot be read.
        """
        self._export = self.settings.first_export
        try:
            there = self._list()
        except OSError as exc:
            raise BadConfig(
                f"{self.settings.folder}: the SEM's export folder cannot be read ({exc.strerror}); create it, or correct sem.folder."
            ) from exc
        if not self.settings.adopt:
            self._taken = {name: _Taken(key, "was there before the run") for name, key in there.items()}

    def poll(self) -> None:
        """Look once; files that became complete are delivered before it returns."""
        try:
            there = self._list()
        except OSError as exc:
            if not self._gone:
                self.on_trouble(f"{self.settings.folder}: the export folder cannot be read ({exc.strerror}); it is tried again.")
            self._gone = True
            return
        if self._gone:
            self._gone = False
            self.on_trouble(f"{self.settings.folder}: the export folder is back.")
        now_ns = self.clock.mono_ns()
        self._forget_vanished(there)
        for name, key in there.items():
            self._look(name, key, now_ns)
        ready = [name for name, candidate in self._candidates.items() if self._is_quiet(candidate, now_ns)]
        for name in sorted(ready, key=lambda one: (self._candidates[one].key[1], one)):
            self._try(name, now_ns)

    def _list(self) -> dict[str, Key]:
        found: dict[str, Key] = {}
        with os.scandir(self.settings.folder) as entries:
            for entry in entries:
                name = entry.name.lower()
                if not name.endswith(self.settings.suffixes) or name.endswith(self.settings.ignore_suffixes) or name.startswith("."):
                    continue
                try:
                    state = os.stat(entry.path)  # scandir's own may be stale on shares and has no file id on Windows
                except OSError:
                    continue  # gone since, or not yet ours to see; the next scan tells
                if stat.S_ISREG(state.st_mode):
                    found[entry.name] = _key(state)
        return found

    def _forget_vanished(self, there: dict[str, Key]) -> None:
        ids = {key[2] for key in there.values()}
        for name in [name for name in self._candidates if name not in there]:
            candidate = self._candidates.pop(name)
            if candidate.key[2] not in ids:  # else it was renamed
                self._refuse(name, candidate.key, "disappeared before it was complete; export into a folder that nobody clears")
        for name in [name for name in self._given_up if name not in there]:
            del self._given_up[name]

    def _look(self, name: str, key: Key, now_ns: int) -> None:
        taken = self._taken.get(name)
        if taken is not None:
            self._look_at_taken(name, taken, key, now_ns)
            return
        given_up = self._given_up.get(name)
        if given_up is not None and _same(given_up, key):
            return
        candidate = self._candidates.get(name)
        if candidate is None or not _same(candidate.key, key):
            self._given_up.pop(name, None)
            self._candidates[name] = _Candidate(key, now_ns)
        else:
            candidate.polls += 1

    def _look_at_taken(self, name: str, taken: _Taken, key: Key, now_ns: int) -> None:
        if _same(taken.key, key):
            return
        still_changing = taken.changed_ns is not None and now_ns - taken.changed_ns < max(self.settings.stable_for_s, 1.0) * 1e9
        taken.key, taken.changed_ns = key, now_ns
        if not still_changing:
            self._refuse(name, key, f"was overwritten: a file of that name {taken.what}; let the SEM count its file names up")

    def _is_quiet(self, candidate: _Candidate, now_ns: int) -> bool:
        long_enough = now_ns - candidate.since_ns >= self.settings.stable_for_s * 1e9
        return long_enough and candidate.polls >= self.settings.stable_polls and now_ns >= candidate.look_again_ns

    def _try(self, name: str, now_ns: int) -> None:
        candidate = self._candidates[name]
        path = self.settings.folder / name
        if candidate.key[0] > self.settings.max_bytes:
            del self._candidates[name]
            self._given_up[name] = candidate.key
            self._refuse(name, candidate.key, f"is larger than {self.settings.max_bytes} bytes; export single images")
            return
        try:
            data = path.read_bytes()
            state = path.stat()
        except OSError as exc:
            self._wait(name, candidate, now_ns, f"cannot be read ({exc.strerror})")
            return
        if not _same(_key(state), candidate.key) or len(data) != state.st_size:
            self._candidates[name] = _Candidate(_key(state), now_ns)
            return
        problem = check_complete(data)
        if problem is not None:
            self._wait(name, candidate, now_ns, f"never became whole ({problem})")
            return
        del self._candidates[name]
        self._deliver(name, candidate.key, data)

    def _wait(self, name: str, candidate: _Candidate, now_ns: int, problem: str) -> None:
        waited_ns = now_ns - candidate.since_ns
        if waited_ns >= self.settings.give_up_after_s * 1e9:
            del self._candidates[name]
            self._given_up[name] = candidate.key
            self._refuse(name, candidate.key, f"{problem}; check the export and the permissions, then export again")
        else:
            # A large file that is not whole yet is not read again at every scan.
            candidate.look_again_ns = now_ns + waited_ns // 4

    def _deliver(self, name: str, key: Key, data: bytes) -> None:
        sha256 = hashlib.sha256(data).hexdigest()
        twin = self._hashes.get(sha256)
        if twin is not None:
            self._taken[name] = _Taken(key, "was refused as a copy")
            self._refuse(name, key, f"holds the same bytes as {twin}; check that the SEM still scans", sha256)
            return
        self._hashes[sha256] = name
        self._taken[name] = _Taken(key, f"was taken as export {self._export}")
        file = ExportedFile(self._export, _as_text(name), data, sha256, key[1], self.clock.now_ns())
        self._export += 1
        self.on_file(file)

    def _refuse(self, name: str, key: Key, reason: str, sha256: str = "") -> None:
        self.on_refused(FileRefused(_as_text(name), f"{_as_text(name)}: {reason}.", key[0], key[1], sha256, self.clock.now_ns()))


def _as_text(name: str) -> str:
    """A file name as it can be written down: bytes that are no text stand as escapes."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


def _same(one: Key, other: Key) -> bool:
    # Without the file id: shares mounted without server inode numbers give a file new ones at will.
    return one[:2] == other[:2]


def _key(state: os.stat_result) -> Key:
    return state.st_size, state.st_mtime_ns, state.st_ino
