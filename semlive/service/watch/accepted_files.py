"""Accepted files: registration, gaps in their numbers, late sidecars, and later changes."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from semlive.data.frame import ExportedFile
from semlive.ports import ClockSource
from semlive.service.watch.file_reader import FileReader, StillReading
from semlive.service.watch.file_registry import DUPLICATE, RegisteredFile
from semlive.service.watch.folder_listing import FolderListing, Key, printable_name
from semlive.service.watch.watch_settings import WatchSettings

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


@dataclass(slots=True)
class AcceptedFiles:
    """Registers accepted files and checks them later.

    Attributes:
        settings: watched folder and timeouts.
        clock: monotonic time.
        listing: the folder, with the registry of processed files.
        reader: reads files whose times have changed.
        on_notice: callback with one sentence about a gap in numbers or a late sidecar.
        on_late_sidecar: callback when a sidecar came after its image was accepted.
        reject: rejects a file by name, key, reason and digest.
        next_export: number of the next accepted file.
    """

    settings: WatchSettings
    clock: ClockSource
    listing: FolderListing
    reader: FileReader
    on_notice: Callable[[str], None]
    reject: Callable[[str, Key, str, str], None]
    next_export: int
    on_late_sidecar: Callable[[], None]
    _without_sidecar: dict[str, int] = field(default_factory=dict)
    _changing: dict[str, int] = field(default_factory=dict)
    _numbering: FileNumbering = field(default_factory=FileNumbering)

    def add(self, name: str, key: Key, file: ExportedFile, deliver: Callable[[ExportedFile], None]) -> None:
        """Register a complete file and deliver it; a file with the bytes of an earlier one is rejected.

        Args:
            name: file name as listed.
            key: its size, times and file id.
            file: the file.
            deliver: callback with the file and its digest.
        """
        sha256 = hashlib.sha256(file.data).hexdigest()
        registry = self.listing.registry
        twin = registry.same_content(sha256)
        if twin is not None:
            registry.put(name, RegisteredFile(key[:3], DUPLICATE))
            self.reject(name, key, f"holds the same bytes as {twin}; check that the SEM still scans", sha256)
            return
        registry.put(name, RegisteredFile(key[:3], self.next_export, sha256))
        if file.sidecar is None:
            self._without_sidecar[name] = self.clock.mono_ns()
        self.next_export += 1
        deliver(replace(file, sha256=sha256))
        notice = self._numbering.check_gap(file.name)
        if notice is not None:
            self.on_notice(notice)

    def is_copy(self, data: bytes) -> bool:
        """Whether an accepted file has these bytes."""
        return self.listing.registry.same_content(hashlib.sha256(data).hexdigest()) is not None

    def check_sidecars(self, now_ns: int) -> None:
        """Report text files that arrived after their images were accepted without them."""
        for name, accepted_ns in list(self._without_sidecar.items()):
            sidecar, registered = self.listing.sidecar(name), self.listing.registry.get(name)
            if sidecar is not None and registered is not None:
                arrival = f"{printable_name(sidecar[0])} came after {printable_name(name)} {registered.description} without it"
                self.on_notice(f"{arrival}; {self._late_text_advice()}.")
                self.on_late_sidecar()
            if sidecar is not None or now_ns - accepted_ns >= self.settings.sidecar_timeout_s * 1e9:
                del self._without_sidecar[name]

    def _late_text_advice(self) -> str:
        if self.settings.row_clock != "if_present":
            return "raise sem.sidecar_timeout_s"
        return "name the SEM in sem.vendor, or set sem.row_clock for row starts, so that the text is waited for"

    def check_changed(self, changed: dict[str, Key], now_ns: int) -> None:
        """Handle registered files that have changed: only their times, or their content."""
        for name, key in changed.items():
            self._check_changed_file(name, key, now_ns)
        self._changing = {name: at_ns for name, at_ns in self._changing.items() if self._is_changing(at_ns, now_ns)}

    def _check_changed_file(self, name: str, key: Key, now_ns: int) -> None:
        registered = self.listing.registry.get(name)
        if registered is None:
            return
        is_same = registered.state[:2] == key[:2]
        if is_same and registered.sha256 and not registered.overwritten:
            try:
                is_same = hashlib.sha256(self.reader.read(self.settings.folder / name, key[0])).hexdigest() == registered.sha256
            except (OSError, StillReading):
                return  # the next scan repeats this
        state = replace(registered, state=key[:3], overwritten=registered.overwritten or not is_same)
        self.listing.registry.put(name, state)
        if is_same:
            return
        # A file that is written slowly, or over a share with interruptions, is overwritten only once.
        still_changing = self._is_changing(self._changing.get(name), now_ns)
        self._changing[name] = now_ns
        if not still_changing:
            reason = f"was overwritten: a file of that name {registered.description}; let the SEM count its file names up"
            self.reject(name, key, reason, "")

    def _is_changing(self, changed_ns: int | None, now_ns: int) -> bool:
        return changed_ns is not None and now_ns - changed_ns < self.settings.give_up_after_s * 1e9
