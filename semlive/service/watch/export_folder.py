"""State of the export folder: files that exist, are being written, or were accepted.

No file-system event means "complete": programs open a file several times, write it slowly, preallocate it or restore its modification time,
and network shares send no events. Therefore the folder is scanned. A file is complete when its size and times have been constant for some
time, its structure is complete (`semlive.formats.check_complete`), it has the header of its vendor, its sidecar and its last rows
(`semlive.formats.check_finished`), and all of this is unchanged after the file was read.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadConfig
from semlive.formats import SIDECAR_VENDORS, check_complete, check_finished, ends_like_partial_file
from semlive.ports import ClockSource
from semlive.service.watch.file_locks import is_locked_error, open_elsewhere
from semlive.service.watch.file_numbering import FileNumbering
from semlive.service.watch.file_reader import FileReader, StillReading
from semlive.service.watch.file_registry import DUPLICATE, PREEXISTING, FileRegistry, RegisteredFile
from semlive.service.watch.sidecars import IMAGE_SUFFIXES, sidecar_names

_LATELY = 3.0  # looks
_MAX_IRREGULAR = 1000
Key = tuple[int, int, int, int]
"""Size, modification time, change time (0 where there is none) and file id."""


@dataclass(frozen=True, slots=True)
class WatchSettings:
    """Watched folder, and criteria for a complete file.

    Attributes:
        folder: export folder of the SEM.
        poll_s: wall seconds between scans.
        stable_for_s: wall seconds for which size and times must be constant.
        stable_polls: number of scans for which they must be constant.
        give_up_after_s: wall seconds after which a constant but unreadable file is rejected.
        max_bytes: a larger file is rejected unread; the log needs twice as much at once.
        suffixes: endings of image files, lower case; other files are ignored.
        ignore_suffixes: endings of files that will be renamed when they are complete.
        adopt: accept files that exist when the watch begins; otherwise they do not belong to this run.
        first_export: number of the first accepted file.
        vendor: whose header every file must have before it is complete; None if any will do.
        sidecar_timeout_s: wall seconds after which a file without the text file that its vendor writes is refused.
        profile: tells the databar where files do not.
    """

    folder: Path
    poll_s: float = 1.0
    stable_for_s: float = 2.0
    stable_polls: int = 2
    give_up_after_s: float = 30.0
    max_bytes: int = 2**28
    suffixes: tuple[str, ...] = IMAGE_SUFFIXES
    ignore_suffixes: tuple[str, ...] = (".tmp", ".temp", ".part", "~")
    adopt: bool = False
    first_export: int = 0
    vendor: str | None = None
    sidecar_timeout_s: float = 60.0
    profile: ScanProfile = field(default_factory=ScanProfile)


@dataclass(frozen=True, slots=True)
class RejectedFile:
    """A rejected file, reported once.

    Attributes:
        name: file name.
        reason: one sentence.
        size: bytes.
        mtime_ns: modification time, UTC ns.
        sha256: digest of its bytes; empty if they were not read.
        time_ns: experiment time of the rejection.
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
    settled_time_ns: int
    beside: tuple[str, Key] | None = None
    polls: int = 0
    look_again_ns: int = 0
    missing_since_ns: int | None = None
    held_since_ns: int | None = None
    held_told: bool = False
    reading_since_ns: int | None = None


@dataclass(frozen=True, slots=True)
class _Listing:
    """Result of one scan of the folder, without unchanged registered files.

    Attributes:
        new: image files that are not registered.
        other: registered files that have changed.
    """

    new: dict[str, Key]
    other: dict[str, Key]


def ignore(_text: str) -> None:
    """Nobody listens."""


@dataclass(slots=True)
class ExportFolder:
    """Scans the export folder; call `poll` from one thread only.

    Attributes:
        settings: what is watched.
        clock: experiment time for arrivals, monotonic time for stability.
        on_file: callback with each complete file once, in order of modification time.
        on_refused: callback with each rejected file once.
        on_trouble: callback with one sentence when the folder disappears and when it is available again.
        on_notice: callback with one sentence about an unusual observation: gaps in numbers, late text files.
        on_replaced: callback with one sentence when another folder replaces it; its files are accepted only after `accept`.
        is_open_elsewhere: whether another program still writes a file, where the system reports it.
        reader: reads the files.
    """

    settings: WatchSettings
    clock: ClockSource
    on_file: Callable[[ExportedFile], None]
    on_refused: Callable[[RejectedFile], None]
    on_trouble: Callable[[str], None]
    on_notice: Callable[[str], None] = ignore
    is_open_elsewhere: Callable[[Path], bool] = open_elsewhere
    on_replaced: Callable[[str], None] = ignore
    reader: FileReader = field(default_factory=FileReader)
    _candidates: dict[str, _Candidate] = field(default_factory=dict)
    _known: FileRegistry = field(default_factory=FileRegistry)
    _alone: dict[str, int] = field(default_factory=dict)
    _changing: dict[str, int] = field(default_factory=dict)
    _given_up: dict[str, tuple[Key, tuple[str, Key] | None]] = field(default_factory=dict)
    _names: FileNumbering = field(default_factory=FileNumbering)
    _export: int = 0
    _gone: bool = False
    _identity: tuple[int, int] = (0, 0)
    _replaced: bool = False
    _irregular: set[str] = field(default_factory=set)
    _looked_ns: int | None = None
    _looked_lately: bool = False

    def open(self) -> None:
        """Scan the folder for the first time.

        Raises:
            BadConfig: it does not exist or cannot be read.
        """
        self._export = self.settings.first_export
        try:
            self._identity = _identity(self.settings.folder)
            for name, key in self._images():
                if not self.settings.adopt:
                    self._known.put(name, RegisteredFile(key[:3], PREEXISTING))
        except OSError as exc:
            raise BadConfig(
                f"{self.settings.folder}: the SEM's export folder cannot be read ({exc.strerror}); create it, or correct sem.folder."
            ) from exc

    def poll(self) -> None:
        """Scan once; complete files are passed on before the method returns."""
        try:
            if self._is_replaced():
                return
            there = self._list()
        except OSError as exc:
            if not self._gone:
                self.on_trouble(f"{self.settings.folder}: the export folder cannot be read ({exc.strerror}); it is tried again.")
            self._gone = True
            self._looked_ns = None
            return
        now_ns = self.clock.mono_ns()
        looked_ns, self._looked_ns = self._looked_ns, now_ns
        # A file that is new after a pause may have been there all the time, so it tells nothing of clocks.
        self._looked_lately = looked_ns is not None and now_ns - looked_ns <= _LATELY * max(self.settings.poll_s, 1e-3) * 1e9
        if self._gone:
            self._gone = False
            self.on_trouble(f"{self.settings.folder}: the export folder is back.")
            for candidate in self._candidates.values():  # nobody saw whether it stood still
                candidate.since_ns, candidate.polls = now_ns, 0
        self._forget_vanished(there.new, now_ns)
        self._look_at_alone(now_ns)
        for name, key in there.other.items():
            self._look_at_known(name, key, now_ns)
        self._changing = {name: at_ns for name, at_ns in self._changing.items() if self._is_changing(at_ns, now_ns)}
        for name, key in there.new.items():
            self._look(name, key, now_ns)
        ready = [name for name, candidate in self._candidates.items() if self._is_quiet(candidate, now_ns)]
        for name in sorted(ready, key=lambda candidate_name: (self._candidates[candidate_name].key[1], candidate_name)):
            self._try(name, now_ns)

    def accept(self) -> None:
        """Continue with the present folder; its existing files do not belong to this run.

        Raises:
            OSError: it cannot be read.
        """
        if not self._replaced:
            return
        self._identity = _identity(self.settings.folder)
        for name, key in self._images():
            registered = self._known.get(name)
            self._known.put(name, RegisteredFile(key[:3], PREEXISTING) if registered is None else replace(registered, state=key[:3]))
        self._candidates.clear()
        self._replaced = False

    def _is_replaced(self) -> bool:
        """Whether another folder has replaced the one that was opened.

        A remounted share has another identity but still holds the registered files, if there are any.

        Raises:
            OSError: it cannot be read.
        """
        identity = _identity(self.settings.folder)
        if identity == self._identity:
            self._replaced = False
            return False
        if not self._replaced:
            there = dict(self._images())
            known = ((key, self._known.get(name)) for name, key in there.items())
            if not there or any(one is not None and one.state[:2] == key[:2] for key, one in known):
                self._identity = identity
                return False
            self._replaced = True
            self.on_replaced(
                f"{self.settings.folder}: the export folder is another one than before, with {len(there)} images of other runs; "
                f"nothing is taken from it: put the old folder back, or resume to go on with what comes into this one"
            )
        return True

    def _images(self) -> Iterator[tuple[str, Key]]:
        """Yield the image files one by one, because a list of a month of files would need more memory than their registry."""
        with os.scandir(self.settings.folder) as entries:
            for entry in entries:
                name = entry.name.lower()
                ours = name.endswith(self.settings.suffixes) and not name.endswith(self.settings.ignore_suffixes) and name[0] != "."
                # scandir's own state may be stale on shares and has no file id on Windows
                if ours and (key := _key_of(entry.path, lambda: self._skip_irregular(entry.name))) is not None:  # noqa: B023  # used at once
                    yield entry.name, key

    def _skip_irregular(self, name: str) -> None:
        if name not in self._irregular and len(self._irregular) < _MAX_IRREGULAR:
            self._irregular.add(name)
            self._refuse(name, (0, 0, 0, 0), "is not a regular file, so it is not read; export into a folder of its own")

    def _list(self) -> _Listing:
        listing = _Listing({}, {})
        for name, key in self._images():
            stands = self._known.is_unchanged(name, key[:3])
            if not stands:
                (listing.new if stands is None else listing.other)[name] = key
        return listing

    def _beside(self, name: str) -> tuple[str, Key] | None:
        """Return the text file of an image if it exists."""
        for sidecar in sidecar_names(name):
            if (key := _key_of(os.path.join(self.settings.folder, sidecar))) is not None:
                return sidecar, key
        return None

    def _forget_vanished(self, there: dict[str, Key], now_ns: int) -> None:
        gone = [name for name in self._candidates if name not in there]
        news = {key for name, key in there.items() if name not in self._candidates} if gone else set()
        for name in gone:
            candidate = self._candidates[name]
            if any(_same(candidate.key, key) for key in news):
                del self._candidates[name]  # it was renamed; its file id would not tell: that of a deleted file is given to the next
            elif candidate.missing_since_ns is None:
                candidate.missing_since_ns = now_ns  # a share that comes back may list its files late
            elif now_ns - candidate.missing_since_ns >= self.settings.stable_for_s * 1e9:
                del self._candidates[name]
                self._refuse(name, candidate.key, "disappeared before it was complete; export into a folder that nobody clears")

    def _look(self, name: str, key: Key, now_ns: int) -> None:
        sidecar = self._beside(name)
        given_up = self._given_up.get(name)
        if given_up is not None and _same(given_up[0], key) and _same_text(given_up[1], sidecar):
            return
        candidate = self._candidates.get(name)
        if candidate is None or candidate.key[:3] != key[:3] or candidate.missing_since_ns is not None:
            self._given_up.pop(name, None)
            self._candidates[name] = _Candidate(key, now_ns, self.clock.now_ns() if self._looked_lately else 0, sidecar)
        elif not _same_text(candidate.beside, sidecar, changed=3):
            # Its own settling counts for the clocks, the newer of the two for completeness.
            candidate.beside, candidate.since_ns, candidate.polls, candidate.look_again_ns = sidecar, now_ns, 0, 0
        else:
            candidate.polls += 1

    def _look_at_alone(self, now_ns: int) -> None:
        """Check recently accepted files without a text file."""
        for name, taken_ns in list(self._alone.items()):
            sidecar, registered = self._beside(name), self._known.get(name)
            if sidecar is not None and registered is not None:
                text, own = _as_text(sidecar[0]), _as_text(name)
                why = f"{text} came after {own} {registered.description} without it"
                self.on_notice(f"{why}; name the SEM in sem.vendor, so that the text is waited for.")
            if sidecar is not None or now_ns - taken_ns >= self.settings.sidecar_timeout_s * 1e9:
                del self._alone[name]

    def _look_at_known(self, name: str, key: Key, now_ns: int) -> None:
        """Handle a registered file that has changed: only its times, or its content."""
        registered = self._known.get(name)
        if registered is None:
            return
        same = registered.state[:2] == key[:2]
        if same and registered.sha256 and not registered.overwritten:
            try:
                same = hashlib.sha256(self.reader.read(self.settings.folder / name, key[0])).hexdigest() == registered.sha256
            except (OSError, StillReading):
                return  # the next scan asks again
        self._known.put(name, replace(registered, state=key[:3], overwritten=registered.overwritten or not same))
        if same:
            return
        # What is written slowly, or over a share that was away meanwhile, is one overwriting.
        still_changing = self._is_changing(self._changing.get(name), now_ns)
        self._changing[name] = now_ns
        if not still_changing:
            self._refuse(name, key, f"was overwritten: a file of that name {registered.description}; let the SEM count its file names up")

    def _is_changing(self, changed_ns: int | None, now_ns: int) -> bool:
        return changed_ns is not None and now_ns - changed_ns < self.settings.give_up_after_s * 1e9

    def _is_quiet(self, candidate: _Candidate, now_ns: int) -> bool:
        long_enough = now_ns - candidate.since_ns >= self.settings.stable_for_s * 1e9
        stable = candidate.polls >= self.settings.stable_polls and candidate.missing_since_ns is None
        return long_enough and stable and now_ns >= candidate.look_again_ns

    def _try(self, name: str, now_ns: int) -> None:
        candidate = self._candidates[name]
        if candidate.key[0] > self.settings.max_bytes:
            self._give_up(name, candidate, f"is larger than {self.settings.max_bytes} bytes; export single images")
            return
        if self.settings.vendor in SIDECAR_VENDORS and candidate.beside is None:
            if now_ns - candidate.since_ns >= self.settings.sidecar_timeout_s * 1e9:
                why = f"never got the text file that {self.settings.vendor} writes for it"
                self._give_up(name, candidate, f"{why}; switch the export of image information on, or raise sem.sidecar_timeout_s")
            return
        if self.is_open_elsewhere(self.settings.folder / name):
            self._hold_back(name, candidate, now_ns)
            return
        try:
            data = self._read_still(name, candidate.key)
            sidecar = None if candidate.beside is None else self._read_still(*candidate.beside)
        except StillReading:
            self._wait_for_read(name, candidate, now_ns)
            return
        except OSError as exc:
            candidate.reading_since_ns = None
            if is_locked_error(exc):
                self._hold_back(name, candidate, now_ns)
                return
            self._wait(name, candidate, now_ns, f"cannot be read ({exc.strerror})")
            return
        candidate.reading_since_ns = None
        if data is None or (sidecar is None and candidate.beside is not None):
            candidate.since_ns, candidate.polls = now_ns, 0
            return
        key = candidate.key
        file = ExportedFile(self._export, _as_text(name), data, "", key[1], self.clock.now_ns(), sidecar, candidate.settled_time_ns)
        problem = check_complete(data) or check_finished(file, self.settings.profile, self.settings.vendor)
        if problem is not None:
            self._wait(name, candidate, now_ns, f"never became complete ({problem})")
            return
        if ends_like_partial_file(data) and now_ns - candidate.since_ns < self.settings.give_up_after_s * 1e9:
            candidate.look_again_ns = now_ns + (now_ns - candidate.since_ns) // 4
            return
        del self._candidates[name]
        self._deliver(name, key, file)

    def _read_still(self, name: str, key: Key) -> bytes | None:
        """Return the bytes of a file; None if it changed during reading."""
        path = self.settings.folder / name
        # What says that it is empty is not opened: so do kernel files, which may block.
        data = self.reader.read(path, key[0]) if key[0] else b""
        return data if _key(path.stat())[:3] == key[:3] else None

    def _wait_for_read(self, name: str, candidate: _Candidate, now_ns: int) -> None:
        """Handle a read that is not finished; other files are processed meanwhile."""
        since_ns = candidate.reading_since_ns = now_ns if candidate.reading_since_ns is None else candidate.reading_since_ns
        if now_ns - since_ns >= self.settings.give_up_after_s * 1e9:
            waited_s = (now_ns - since_ns) / 1e9
            self.reader.forget(self.settings.folder / name)
            self._give_up(name, candidate, f"could not be read within {waited_s:.0f} s; check what it links to, and the share")

    def _hold_back(self, name: str, candidate: _Candidate, now_ns: int) -> None:
        """Handle a file that another program has open: it is never rejected for that; a long wait is reported once."""
        since_ns = candidate.held_since_ns = now_ns if candidate.held_since_ns is None else candidate.held_since_ns
        candidate.since_ns, candidate.polls = now_ns, 0
        if now_ns - since_ns >= self.settings.give_up_after_s * 1e9 and not candidate.held_told:
            candidate.held_told = True
            waited_s = (now_ns - since_ns) / 1e9
            self.on_notice(f"{_as_text(name)}: another program has had it open for {waited_s:.0f} s; it is taken when that lets go of it.")

    def _wait(self, name: str, candidate: _Candidate, now_ns: int, problem: str) -> None:
        waited_ns = now_ns - candidate.since_ns
        if waited_ns >= self.settings.give_up_after_s * 1e9:
            self._give_up(name, candidate, f"{problem}; check the export and the permissions, then export again")
        else:
            # A large file that is not whole yet is not read again at every scan.
            candidate.look_again_ns = now_ns + waited_ns // 4

    def _give_up(self, name: str, candidate: _Candidate, reason: str) -> None:
        del self._candidates[name]
        self._given_up[name] = candidate.key, candidate.beside
        self._refuse(name, candidate.key, reason)

    def _deliver(self, name: str, key: Key, file: ExportedFile) -> None:
        sha256 = hashlib.sha256(file.data).hexdigest()
        twin = self._known.same_content(sha256)
        if twin is not None:
            self._known.put(name, RegisteredFile(key[:3], DUPLICATE))
            self._refuse(name, key, f"holds the same bytes as {twin}; check that the SEM still scans", sha256)
            return
        self._known.put(name, RegisteredFile(key[:3], self._export, sha256))
        if file.sidecar is None:
            self._alone[name] = self.clock.mono_ns()
        self._export += 1
        self.on_file(replace(file, sha256=sha256))
        notice = self._names.check_gap(file.name)
        if notice is not None:
            self.on_notice(notice)

    def _refuse(self, name: str, key: Key, reason: str, sha256: str = "") -> None:
        self.on_refused(RejectedFile(_as_text(name), f"{_as_text(name)}: {reason}.", key[0], key[1], sha256, self.clock.now_ns()))


def _as_text(name: str) -> str:
    """Return a printable file name; bytes that are not text are escaped."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


def _same(first: Key, second: Key) -> bool:
    # Without the file id: shares mounted without server inode numbers give a file new ones at will.
    return first[:2] == second[:2]


def _same_text(first: tuple[str, Key] | None, second: tuple[str, Key] | None, changed: int = 2) -> bool:
    """Whether the text beside an image is the same; `changed` of 3 asks its change time too."""
    if first is None or second is None:
        return first is second
    return first[0] == second[0] and first[1][:changed] == second[1][:changed]


def _identity(folder: Path) -> tuple[int, int]:
    state = os.stat(folder)
    return state.st_dev, state.st_ino


def _key_of(path: str, on_irregular: Callable[[], None] = lambda: None) -> Key | None:
    """Of a file; None for what is none, is gone since, or is not yet ours to see: the next scan tells."""
    try:
        state = os.stat(path)
    except OSError:
        return None
    if stat.S_ISREG(state.st_mode):
        return _key(state)
    if not stat.S_ISDIR(state.st_mode):
        on_irregular()
    return None


def _key(state: os.stat_result) -> Key:
    # On Windows st_ctime is the time of creation, which tells nothing.
    return state.st_size, state.st_mtime_ns, 0 if os.name == "nt" else state.st_ctime_ns, state.st_ino
