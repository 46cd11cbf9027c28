"""Regular files only, of limited size."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from semlive.inputs.files import open_regular, read_regular


def test_a_file_up_to_its_limit_is_read(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 3_000_000)
    assert read_regular(path, 3_000_000) == b"x" * 3_000_000
    with pytest.raises(OSError, match="larger than") as error:
        read_regular(path, 2_999_999)
    assert error.value.strerror == "it is larger than 3 MB"
    with open_regular(path) as stream:
        stream.seek(2_999_990)
        assert stream.read() == b"x" * 10


def test_a_folder_and_a_missing_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        read_regular(tmp_path, 10)
    with pytest.raises(FileNotFoundError):
        read_regular(tmp_path / "missing", 10)


@pytest.mark.timeout(10)
def test_a_fifo_and_an_endless_device_are_refused_at_once(tmp_path: Path) -> None:
    special = [Path(os.devnull)]
    if hasattr(os, "mkfifo"):
        fifo, link = tmp_path / "fifo", tmp_path / "link"
        os.mkfifo(fifo)
        link.symlink_to(fifo)
        special += [fifo, link, Path("/dev/zero")]
    for path in special:
        assert not stat.S_ISREG(path.stat().st_mode)
        with pytest.raises(OSError, match="not a regular file"):
            read_regular(path, 10)
