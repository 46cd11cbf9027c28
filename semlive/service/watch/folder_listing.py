"""Listing of an export folder: new and changed image files, sidecars, and replacement of the folder itself."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from semlive.service.watch.file_registry import PREEXISTING, FileRegistry, RegisteredFile
from semlive.service.watch.sidecars import in_other_case, sidecar_names, text_files
from semlive.service.watch.untaken_files import UntakenFiles
from semlive.service.watch.watch_settings import WatchSettings

_MAX_IRREGULAR = 1000
Key = tuple[int, int, int, int]
"""Size, modification time, change time (0 where there is none) and file id."""
Sidecar = tuple[str, Key]
"""Name and key of the text file of an image."""


@dataclass(frozen=True, slots=True)
class Listing:
    """Result of one scan of the folder, without unchanged registered files.

    Attributes:
        new: image files that are not registered.
        changed: registered files that have changed.
    """

    new: dict[str, Key]
    changed: dict[str, Key]


@dataclass(slots=True)
class FolderListing:
    """Scans the folder and compares it with the registered files.

    Attributes:
        settings: watched folder.
        registry: processed files.
        on_irregular: callback with the name of each image file that is not a regular file, once.
        untaken: other files, of which the first of each kind is reported.
    """

    settings: WatchSettings
    registry: FileRegistry
    on_irregular: Callable[[str], None]
    untaken: UntakenFiles
    _text_files: dict[str, str] | None = None
    _irregular: set[str] = field(default_factory=set)
    _identity: tuple[int, int] = (0, 0)
    _is_replaced: bool = False

    def open(self) -> None:
        """Scan the folder for the first time.

        Raises:
            OSError: it cannot be read.
        """
        self._identity = _identity(self.settings.folder)
        for name, key in self._images(self.untaken.record):
            if not self.settings.adopt:
                self.registry.put(name, RegisteredFile(key[:3], PREEXISTING))

    def changes(self) -> Listing:
        """Return new and changed image files.

        Raises:
            OSError: the folder cannot be read.
        """
        listing = Listing({}, {})
        self._text_files = None
        for name, key in self._images(self.untaken.observe):
            is_unchanged = self.registry.is_unchanged(name, key[:3])
            if not is_unchanged:
                (listing.new if is_unchanged is None else listing.changed)[name] = key
        return listing

    def sidecar(self, name: str) -> Sidecar | None:
        """Return the text file of an image; None if it does not exist. Letter case is ignored if no name agrees exactly."""
        for sidecar in sidecar_names(name):
            if (key := _key_of_path(os.path.join(self.settings.folder, sidecar))) is not None:
                return sidecar, key
        if self._text_files is None:  # once in a scan, because it lists the folder again
            try:
                self._text_files = text_files(self.settings.folder)
            except OSError:
                return None
        other = in_other_case(name, self._text_files)
        key = None if other is None else _key_of_path(os.path.join(self.settings.folder, other))
        return None if other is None or key is None else (other, key)

    def accept(self) -> bool:
        """Continue with the folder that replaced the original one; False if no other folder did.

        Raises:
            OSError: it cannot be read.
        """
        if not self._is_replaced:
            return False
        self._identity = _identity(self.settings.folder)
        for name, key in self._images(self.untaken.record):
            registered = self.registry.get(name)
            self.registry.put(name, RegisteredFile(key[:3], PREEXISTING) if registered is None else replace(registered, state=key[:3]))
        self._is_replaced = False
        return True

    def is_replaced(self, report: Callable[[int], None]) -> bool:
        """Whether another folder has replaced the one that was opened.

        A remounted share has another identity but still contains the registered files, if there are any.

        Args:
            report: callback with the number of images in the other folder, when the replacement is detected.

        Raises:
            OSError: it cannot be read.
        """
        identity = _identity(self.settings.folder)
        if identity == self._identity:
            self._is_replaced = False
            return False
        if not self._is_replaced:
            images = dict(self._images())
            files = ((key, self.registry.get(name)) for name, key in images.items())
            if not images or any(file is not None and file.state[:2] == key[:2] for key, file in files):
                self._identity = identity
                return False
            self._is_replaced = True
            report(len(images))
        return True

    def _images(self, on_other: Callable[[os.DirEntry[str]], None] = lambda _entry: None) -> Iterator[tuple[str, Key]]:
        """Yield the image files one by one, because a list of a month of files would need more memory than their registry.

        Args:
            on_other: callback with each other entry.
        """
        with os.scandir(self.settings.folder) as entries:
            for entry in entries:
                name = entry.name.lower()
                is_image = name.endswith(self.settings.suffixes) and not name.endswith(self.settings.ignore_suffixes) and name[0] != "."
                # scandir's own state may be stale on shares and has no file id on Windows
                if is_image and (key := _key_of_path(entry.path, lambda: self._skip_irregular(entry.name))) is not None:  # noqa: B023  # used at once
                    yield entry.name, key
                if not is_image:
                    on_other(entry)

    def _skip_irregular(self, name: str) -> None:
        if name not in self._irregular and len(self._irregular) < _MAX_IRREGULAR:
            self._irregular.add(name)
            self.on_irregular(name)


def printable_name(name: str) -> str:
    """Return a printable file name; bytes that are not text are escaped."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


def is_same_file(first: Key, second: Key) -> bool:
    """Whether size and modification time are equal. File ids are ignored: some shares assign new ones at any time."""
    return first[:2] == second[:2]


def is_same_sidecar(first: Sidecar | None, second: Sidecar | None, compared: int = 2) -> bool:
    """Whether the text file of an image is the same; `compared` of 3 compares its change time too."""
    if first is None or second is None:
        return first is second
    return first[0] == second[0] and first[1][:compared] == second[1][:compared]


def key_of(state: os.stat_result) -> Key:
    """Return the key of a file."""
    # On Windows st_ctime is the time of creation, which does not show changes.
    return state.st_size, state.st_mtime_ns, 0 if os.name == "nt" else state.st_ctime_ns, state.st_ino


def _identity(folder: Path) -> tuple[int, int]:
    state = os.stat(folder)
    return state.st_dev, state.st_ino


def _key_of_path(path: str, on_irregular: Callable[[], None] = lambda: None) -> Key | None:
    """Return the key of a file; None if it is not a regular file, or not (yet) accessible, so that the next scan decides."""
    try:
        state = os.stat(path)
    except OSError:
        return None
    if stat.S_ISREG(state.st_mode):
        return key_of(state)
    if not stat.S_ISDIR(state.st_mode):
        on_irregular()
    return None
