"""State of the export folder: files that exist, are being written, or were accepted.

No file-system event means "complete": programs open a file several times, write it slowly, preallocate it or restore its modification time,
and network shares send no events. Therefore the folder is scanned. A file is complete when its size and times have been constant for some
time, its structure is complete (`semlive.formats.check_complete`), it has the header of its vendor, its sidecar and its last rows
(`semlive.formats.check_finished`), and all of this is unchanged after the file was read. The time is short for a file whose bytes prove
that they are all written (`semlive.formats.prove_complete`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from semlive.data.frame import ExportedFile
from semlive.errors import BadConfig
from semlive.formats import check_complete, check_finished, ends_like_partial_file
from semlive.ports import ClockSource
from semlive.service.watch.accepted_files import AcceptedFiles
from semlive.service.watch.awaited_texts import MissingText, awaits_texts, missing_text
from semlive.service.watch.byte_proofs import ByteProofs
from semlive.service.watch.candidates import Candidate, Candidates
from semlive.service.watch.file_locks import is_locked_error, open_elsewhere
from semlive.service.watch.file_reader import FileReader, StillReading
from semlive.service.watch.file_registry import FileRegistry
from semlive.service.watch.folder_listing import FolderListing, Key, key_of, printable_name
from semlive.service.watch.untaken_files import UntakenFiles
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings

_MAX_SCAN_GAP = 3.0  # intervals between scans


def ignore(_text: str) -> None:
    """Ignore a message."""


@dataclass(slots=True)
class ExportFolder:
    """Scans the export folder; call `poll` from one thread only.

    Attributes:
        settings: watched folder, and criteria for a complete file.
        clock: experiment time for arrivals, monotonic time for stability.
        on_file: callback with each complete file once, in order of modification time.
        on_refused: callback with each rejected file once.
        on_trouble: callback with one sentence when the folder disappears and when it is available again.
        on_notice: callback with one sentence about an unusual observation: gaps in numbers, late text files, files that are not taken.
        on_replaced: callback with one sentence when another folder replaces it; its files are accepted only after `accept`.
        is_open_elsewhere: whether another program still writes a file, where the system reports it.
        reader: reads the files.
        news: number of new and changed files that the scans have found.
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
    news: int = 0
    _listing: FolderListing = field(init=False)
    _candidates: Candidates = field(init=False)
    _accepted: AcceptedFiles = field(init=False)
    _proofs: ByteProofs = field(init=False)
    _is_unavailable: bool = False
    _scanned_ns: int | None = None

    def __post_init__(self) -> None:
        self._listing = FolderListing(self.settings, FileRegistry(), self._reject_irregular, UntakenFiles(self.settings, self.on_notice))
        self._candidates = Candidates(self.settings, self.clock, self._listing, self._reject)
        self._proofs = ByteProofs(self.settings.profile)
        self._accepted = AcceptedFiles(
            *(self.settings, self.clock, self._listing, self.reader, self.on_notice, self._reject, self.settings.first_export),
            self._proofs.await_texts,
        )

    def open(self) -> None:
        """Scan the folder for the first time.

        Raises:
            BadConfig: it does not exist or cannot be read.
        """
        try:
            self._listing.open()
        except OSError as exc:
            raise BadConfig(
                f"{self.settings.folder}: the SEM's export folder cannot be read ({exc.strerror}); create it, or correct sem.folder."
            ) from exc

    def poll(self) -> None:
        """Scan once; complete files are passed on before the method returns."""
        try:
            if self._listing.is_replaced(self._report_replaced):
                return
            listing = self._listing.changes()
        except OSError as exc:
            if not self._is_unavailable:
                self.on_trouble(f"{self.settings.folder}: the export folder cannot be read ({exc.strerror}); it is tried again.")
            self._is_unavailable = True
            self._scanned_ns = None
            return
        now_ns = self.clock.mono_ns()
        previous_ns, self._scanned_ns = self._scanned_ns, now_ns
        # A file that is new after a pause may have been there for a long time, so it is no evidence of clock offsets.
        is_timely = previous_ns is not None and now_ns - previous_ns <= _MAX_SCAN_GAP * max(self.settings.poll_s, 1e-3) * 1e9
        if self._is_unavailable:
            self._is_unavailable = False
            self.on_trouble(f"{self.settings.folder}: the export folder is back.")
            self._candidates.restart(now_ns)
        self._candidates.forget_vanished(listing.new, now_ns)
        self._accepted.check_sidecars(now_ns)
        self._accepted.check_changed(listing.changed, now_ns)
        for name, key in listing.new.items():
            if self._candidates.observe(name, key, now_ns, is_timely):
                self.news += 1
                if self.reader.is_hanging:
                    self.reader.forget(self.settings.folder / name)  # its read began before the change
        for name in self._candidates.stable(now_ns):
            self._try(name, now_ns)
            if self.settings.row_clock != "if_present" and name in self._candidates:
                break  # frames whose clocks come late keep their order
        for name in self._candidates.provable(now_ns):
            self._try_at_once(name, now_ns)

    def next_due_s(self) -> float | None:
        """Return the seconds until a file may be complete if it does not change, or None."""
        now_ns = self.clock.mono_ns()
        due_ns = self._candidates.next_due_ns(now_ns)
        return None if due_ns is None else (due_ns - now_ns) / 1e9

    def accept(self) -> None:
        """Continue with the present folder; its existing files do not belong to this run.

        Raises:
            OSError: it cannot be read.
        """
        if self._listing.accept():
            self._candidates.clear()

    def _report_replaced(self, images: int) -> None:
        self.on_replaced(
            f"{self.settings.folder}: the export folder is another one than before, with {images} images of other runs; "
            f"nothing is taken from it: put the old folder back, or resume to continue with the files that arrive in this one"
        )

    def _try(self, name: str, now_ns: int) -> None:
        candidate = self._candidates[name]
        if candidate.key[0] > self.settings.max_bytes:
            self._candidates.give_up(name, candidate, f"is larger than {self.settings.max_bytes} bytes; export single images")
            return
        if candidate.sidecar is None and self._waits(name, candidate, missing_text(self.settings, None), now_ns):
            return
        if self.is_open_elsewhere(self.settings.folder / name):
            self._hold_back(name, candidate, now_ns)
            return
        try:
            data = self._read_unchanged(name, candidate.key)
            sidecar = None if candidate.sidecar is None else self._read_unchanged(*candidate.sidecar)
        except StillReading:
            self._wait_for_read(name, candidate, now_ns)
            return
        except OSError as exc:
            candidate.reading_since_ns = None
            if is_locked_error(exc):
                self._hold_back(name, candidate, now_ns)
                return
            self._candidates.retry_later(name, candidate, now_ns, f"cannot be read ({exc.strerror})")
            return
        candidate.reading_since_ns = None
        if data is None or (sidecar is None and candidate.sidecar is not None):
            candidate.restart(now_ns)
            return
        self._check(name, candidate, data, sidecar, now_ns)

    def _waits(self, name: str, candidate: Candidate, missing: MissingText | None, now_ns: int) -> bool:
        """Whether a file cannot be accepted because its text file is missing: it waits for that, or is rejected after the timeout."""
        if missing is None:
            return False
        is_late = now_ns - candidate.since_ns >= self.settings.sidecar_timeout_s * 1e9
        if is_late and missing.is_needed:
            self._candidates.give_up(name, candidate, missing.reason)
        return missing.is_needed or not is_late

    def _check(self, name: str, candidate: Candidate, data: bytes, sidecar: bytes | None, now_ns: int) -> None:
        """Accept a file that was read if it is complete and finished."""
        missing = missing_text(self.settings, sidecar)
        if self._waits(name, candidate, missing, now_ns):
            return
        file = self._file(name, candidate, data, sidecar)
        problem = check_complete(data) or check_finished(file, self.settings.profile, self.settings.vendor)
        if problem is not None:
            self._candidates.retry_later(name, candidate, now_ns, f"never became complete ({problem})")
            return
        if ends_like_partial_file(data) and now_ns - candidate.since_ns < self.settings.give_up_after_s * 1e9:
            candidate.next_try_ns = now_ns + (now_ns - candidate.since_ns) // 4
            return
        self._proofs.awaited(file)
        self._candidates.remove(name)
        if missing is not None:
            self.on_notice(f"{printable_name(name)}: {missing.reason}.")
        self._accepted.add(name, candidate.key, file, self.on_file)

    def _try_at_once(self, name: str, now_ns: int) -> None:
        """Accept a file if its bytes prove that it is complete; only time can prove that a text file is."""
        candidate, path = self._candidates[name], self.settings.folder / name
        if candidate.sidecar is not None or awaits_texts(self.settings) or candidate.key[0] > self.settings.max_bytes:
            return
        if self.is_open_elsewhere(path):
            self._hold_back(name, candidate, now_ns)
            return
        try:
            data = self._read_unchanged(name, candidate.key)
        except (OSError, StillReading):
            self.reader.forget(path)
            return
        if data is None or check_complete(data) is not None:
            return
        file = self._file(name, candidate, data, None)
        is_finished = check_finished(file, self.settings.profile, self.settings.vendor) is None
        if is_finished and not self._accepted.is_copy(data) and self._proofs.accepts(file):
            self._candidates.remove(name)
            self._accepted.add(name, candidate.key, file, self.on_file)

    def _file(self, name: str, candidate: Candidate, data: bytes, sidecar: bytes | None) -> ExportedFile:
        settled_ns, number = candidate.settled_time_ns, self._accepted.next_export
        return ExportedFile(number, printable_name(name), data, "", candidate.key[1], self.clock.now_ns(), sidecar, settled_ns)

    def _read_unchanged(self, name: str, key: Key) -> bytes | None:
        """Return the bytes of a file; None if it changed during reading."""
        path = self.settings.folder / name
        # A file of size 0 is not opened, because kernel files have this size and may block.
        data = self.reader.read(path, key[0]) if key[0] else b""
        return data if key_of(path.stat())[:3] == key[:3] else None

    def _wait_for_read(self, name: str, candidate: Candidate, now_ns: int) -> None:
        """Handle a read that is not finished; other files are processed meanwhile."""
        since_ns = candidate.reading_since_ns = now_ns if candidate.reading_since_ns is None else candidate.reading_since_ns
        if now_ns - since_ns >= self.settings.give_up_after_s * 1e9:
            waited_s = (now_ns - since_ns) / 1e9
            self.reader.forget(self.settings.folder / name)
            reason = f"could not be read within {waited_s:.0f} s; check what it links to, and the share"
            self._candidates.give_up(name, candidate, reason)

    def _hold_back(self, name: str, candidate: Candidate, now_ns: int) -> None:
        """Handle a file that another program has open: it is never rejected for that; a long wait is reported once."""
        since_ns = candidate.held_since_ns = now_ns if candidate.held_since_ns is None else candidate.held_since_ns
        candidate.restart(now_ns)
        if now_ns - since_ns >= self.settings.give_up_after_s * 1e9 and not candidate.hold_is_reported:
            candidate.hold_is_reported = True
            waited_s = (now_ns - since_ns) / 1e9
            state = f"{printable_name(name)}: another program has had it open for {waited_s:.0f} s"
            self.on_notice(f"{state}; it is taken when that lets go of it.")

    def _reject_irregular(self, name: str) -> None:
        self._reject(name, (0, 0, 0, 0), "is not a regular file, so it is not read; export into a folder of its own")

    def _reject(self, name: str, key: Key, reason: str, sha256: str = "") -> None:
        shown = printable_name(name)
        self.on_refused(RejectedFile(shown, f"{shown}: {reason}.", key[0], key[1], sha256, self.clock.now_ns()))
