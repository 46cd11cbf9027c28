"""Output files and folders of commands: checked before the work begins, and replaced at once."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from semlive.errors import BadInput, SemliveError

_PARTIAL_SUFFIX = ".part"
_KERNEL_FOLDERS = frozenset(("proc", "sys"))
"""Folders of the kernel on Linux; root seems to have the right to write there."""


def output_file(path: Path, option: str) -> Path:
    """Make the folder of an output file and check that the file can be written.

    An existing file stays as it is. A device such as `/dev/stdout` is accepted.

    Args:
        path: the file.
        option: option or argument that gives it, for messages.

    Returns:
        The path.

    Raises:
        BadInput: it is a folder, its folder cannot be made, or it cannot be written.
    """
    if path.is_dir():
        raise BadInput(f"{option} {path}: is a folder; give the name of a file")
    if path.exists():
        if not os.access(path, os.W_OK):
            raise BadInput(f"{option} {path}: the file cannot be overwritten; give another name")
        return path
    output_folder(path.parent, option).mkdir(parents=True, exist_ok=True)
    return path


def regular_output_file(path: Path, option: str) -> Path:
    """As `output_file`, for files that are written under another name and renamed, which would replace a device.

    Raises:
        BadInput: as for `output_file`, or it is a device.
    """
    if output_file(path, option).exists() and not path.is_file():
        raise BadInput(f"{option} {path}: is a device; give the name of a file")
    return path


def output_folder(path: Path, option: str) -> Path:
    """Check that a folder can be made, or that files can be made in it; nothing is made.

    Args:
        path: the folder.
        option: option or argument that gives it, for messages.

    Returns:
        The path.

    Raises:
        BadInput: the path, or the part of it that exists, is a file or a folder in which no file can be made.
    """
    existing = next(part for part in (path.absolute(), *path.absolute().parents) if os.path.lexists(part))
    if not existing.is_dir():
        raise BadInput(f"{option} {path}: {existing} is a file; give the path of a folder")
    if _KERNEL_FOLDERS.intersection(existing.parts[1:2]) or not os.access(existing, os.W_OK | os.X_OK):
        raise BadInput(f"{option} {path}: no file can be made in {existing}; give a path that can be written")
    return path


@contextlib.contextmanager
def emptied_if_refused(path: Path) -> Iterator[None]:
    """Make a folder, new or empty, for what the context writes; after bad input it is as before, for the corrected command."""
    new_folders = [part for part in (path, *path.parents) if not part.exists()]
    path.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BadInput:
        for entry in path.iterdir():
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            else:
                entry.unlink()
        with contextlib.suppress(OSError):
            for folder in new_folders:
                folder.rmdir()
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, as `write_bytes`.

    Raises:
        SemliveError: it cannot be written.
    """
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file; a regular file is replaced at once, so that no half-written file remains.

    Raises:
        SemliveError: it cannot be written.
    """
    part = path.with_name(path.name + _PARTIAL_SUFFIX)
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(content)
            return
        part.write_bytes(content)
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise SemliveError(f"{path}: cannot be written ({error.strerror}); make room, or give another path") from error
