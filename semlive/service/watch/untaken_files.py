"""Files in the export folder that a run does not take: other formats, and images in folders inside it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from semlive.service.watch.sidecars import SIDECAR_SUFFIXES
from semlive.service.watch.watch_settings import WatchSettings

OTHER_IMAGES = (
    ".jpg",
    ".jpeg",
    ".jfif",
    ".bmp",
    ".gif",
    ".jp2",
    ".webp",
    ".dm3",
    ".dm4",
    ".ser",
    ".emi",
    ".mrc",
    ".raw",
    ".img",
    ".czi",
    ".pdf",
)
FOLDER = "folder"
_HOUSEKEEPING = ("thumbs.db", "desktop.ini", "ehthumbs.db", "icon\r")
_MAX_NAMES = 1000
_MAX_ENTRIES_INSIDE = 1000
_MAX_DEPTH = 3


def kind_of(entry: os.DirEntry[str], settings: WatchSettings) -> str | None:
    """Return the ending of a file that a run does not take, or `FOLDER`; None for images, text files of images and hidden files."""
    name = entry.name.lower()
    if name[0] in ".$" or name in _HOUSEKEEPING or name.endswith(settings.ignore_suffixes):
        return None
    if entry.is_dir():
        return FOLDER
    ending = os.path.splitext(name)[1]
    return None if ending in settings.suffixes or ending in SIDECAR_SUFFIXES else ending


def image_inside(path: str, settings: WatchSettings, depth: int = _MAX_DEPTH) -> str | None:
    """Return the path of the first image in a folder or the folders inside it, relative to its parent; None if there is none."""
    folders: list[os.DirEntry[str]] = []
    try:
        with os.scandir(path) as entries:
            for _, entry in zip(range(_MAX_ENTRIES_INSIDE), entries, strict=False):
                if entry.is_dir():
                    folders.append(entry)
                elif entry.name.lower().endswith((*settings.suffixes, *OTHER_IMAGES)):
                    return f"{os.path.basename(path)}/{entry.name}"
    except OSError:
        return None
    if depth == 1:
        return None
    found = (image_inside(folder.path, settings, depth - 1) for folder in sorted(folders, key=lambda folder: folder.name, reverse=True))
    inside = next((image for image in found if image is not None), None)
    return None if inside is None else f"{os.path.basename(path)}/{inside}"


def reason(kind: str, settings: WatchSettings) -> str:
    """Return why a run does not take a kind, and what to do: one clause."""
    taken = ", ".join(settings.suffixes)
    if kind == FOLDER:
        return "a run does not look into folders inside the export folder; switch folders of the day off, or set sem.folder to this folder"
    if kind in OTHER_IMAGES:
        return f"a run takes {taken} only; set the SEM's export to TIFF"
    return f"a run takes {taken} only; if it is an image, set the SEM's export to TIFF"


@dataclass(slots=True)
class UntakenFiles:
    """Reports the first new file of each kind that a run does not take.

    Attributes:
        settings: watched folder.
        report: callback with one sentence.
    """

    settings: WatchSettings
    report: Callable[[str], None]
    _existing: dict[str, int] = field(default_factory=dict)
    _reported: set[str] = field(default_factory=set)

    def record(self, entry: os.DirEntry[str]) -> None:
        """Record an entry that exists before the run."""
        if kind_of(entry, self.settings) is not None and len(self._existing) < _MAX_NAMES:
            self._existing[entry.name] = _changed_ns(entry)

    def observe(self, entry: os.DirEntry[str]) -> None:
        """Report an entry if it is new, or a folder with new entries, and the first of its kind."""
        kind = kind_of(entry, self.settings)
        if kind is None or kind in self._reported:
            return
        if kind != FOLDER:
            if entry.name not in self._existing and len(self._existing) < _MAX_NAMES:
                self._report(kind, entry.name)
            return
        changed_ns = _changed_ns(entry)
        if self._existing.get(entry.name) != changed_ns and len(self._existing) < _MAX_NAMES:
            self._existing[entry.name] = changed_ns
            image = image_inside(entry.path, self.settings)
            if image is not None:
                self._report(kind, image)

    def _report(self, kind: str, name: str) -> None:
        self._reported.add(kind)
        shown = name.encode("utf-8", "backslashreplace").decode("utf-8")
        self.report(f"{shown}: is not taken, because {reason(kind, self.settings)}; further files of this kind are not reported.")


@dataclass(frozen=True, slots=True)
class FolderContent:
    """Content of an export folder.

    Attributes:
        images: number of files that a run would take.
        newest: path of the newest of them; empty if there is none.
        others: number of files and the first name by kind, of those that a run would not take.
    """

    images: int
    newest: str
    others: dict[str, tuple[int, str]]


def content_of(settings: WatchSettings) -> FolderContent:
    """Return the content of the export folder.

    Raises:
        OSError: it cannot be read.
    """
    images, newest, others = 0, (0, ""), dict[str, tuple[int, str]]()
    with os.scandir(settings.folder) as entries:
        for entry in entries:
            name = entry.name.lower()
            if name.endswith(settings.suffixes) and name[0] != "." and not entry.is_dir():
                images += 1
                newest = max(newest, (_changed_ns(entry), entry.path))
            elif (kind := kind_of(entry, settings)) is not None:
                first = image_inside(entry.path, settings) if kind == FOLDER else entry.name
                if first is not None:
                    count, earlier = others.get(kind, (0, first))
                    others[kind] = (count + 1, min(earlier, first))
    return FolderContent(images, newest[1], others)


def described(content: FolderContent, settings: WatchSettings) -> Iterator[tuple[str, str]]:
    """Yield for each kind that a run would not take what was found, and why it is not taken."""
    for kind, (count, first) in sorted(content.others.items()):
        what = f"{count} folder{'s' if count > 1 else ''} with images" if kind == FOLDER else f"{count} {kind or 'without ending'}"
        yield f"{what} ({first})", reason(kind, settings)


def _changed_ns(entry: os.DirEntry[str]) -> int:
    try:
        return os.stat(entry.path).st_mtime_ns
    except OSError:
        return 0
