"""Files of triggered frames: complete under a temporary name before they appear in the export folder under their own."""

from __future__ import annotations

import contextlib
import os
import tempfile
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

import numpy as np
import tifffile
from numpy.typing import NDArray

from semlive.data.scan_report import ScanReading
from semlive.errors import LinkRefused

_MAX_NUMBER = 999_999


def require_folder(folder: Path) -> None:
    """Check that frames can be written into a folder.

    Raises:
        LinkRefused: it is no absolute path, does not exist, or this user cannot write there.
    """
    if not folder.is_absolute():
        raise LinkRefused(f"sem.trigger.settings.folder: {folder} is no absolute path; give the full path of sem.folder")
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise LinkRefused(f"sem.trigger.settings.folder: {folder} is no folder in which this user can write; give the path of sem.folder")


@dataclass
class PendingFrame:
    """A frame that is not in the export folder yet; a context that removes what was not published.

    Attributes:
        image: path under which the image is written.
        target: path of the image when it is published.
        sidecar: content of its text file, empty without one; written with the image.
    """

    image: Path
    target: Path
    sidecar: str = ""
    _scratch: Path = field(default_factory=Path)

    @classmethod
    def of(cls, folder: Path, prefix: str) -> PendingFrame:
        """Return a frame with the next free number.

        Raises:
            LinkRefused: the folder cannot be used, or all numbers are used.
        """
        require_folder(folder)
        taken = [name[len(prefix) + 1 : -4] for name in os.listdir(folder) if name.startswith(f"{prefix}_") and name.endswith(".tif")]
        number = 1 + max((int(text) for text in taken if text.isdecimal()), default=0)
        if number > _MAX_NUMBER:
            raise LinkRefused(f"{folder}: all numbers of {prefix}_*.tif are used; move old files away, or set another prefix")
        # The watcher of the folder takes no files of folders that begin with a dot; the same file system makes the renaming atomic.
        scratch = Path(tempfile.mkdtemp(prefix=".semlive-", dir=folder))
        target = folder / f"{prefix}_{number:06d}.tif"
        return cls(scratch / target.name, target, "", scratch)

    def __enter__(self) -> PendingFrame:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with contextlib.suppress(OSError):
            for path in self._scratch.iterdir():
                path.unlink()
            self._scratch.rmdir()

    def publish(self) -> str:
        """Move text file, then image, into the export folder; return the name of the image.

        Raises:
            LinkRefused: a file of that name appeared meanwhile, or the folder cannot be written.
        """
        try:
            if self.sidecar:
                text = self._scratch / f"{self.target.stem}.hdr"
                text.write_text(self.sidecar, encoding="cp1252", newline="")
                os.replace(text, self.target.with_suffix(".hdr"))
            if self.target.exists():
                raise LinkRefused(f"{self.target}: exists already; let no other program write {self.target.name[:-10]}*.tif there")
            os.replace(self.image, self.target)
        except OSError as error:
            raise LinkRefused(f"{self.target}: cannot be written ({error.strerror or error})") from error
        return self.target.name


def write_image(frame: PendingFrame, pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write pixels (height, width) as an uncompressed TIFF."""
    tifffile.imwrite(frame.image, pixels, photometric="minisblack", software="semlive")


def tescan_header(reading: ScanReading, device: str, end_time_ns: int) -> str:
    """Text file of an image that the interface of a TESCAN microscope sent, with the keys that TESCAN's own export writes.

    ``RowTime`` (s) is a key of semlive: TESCAN's files contain none. The time is UTC, at the end of the scan, to the millisecond.
    """
    end = datetime.fromtimestamp(end_time_ns / 1e9, UTC)
    pixel = f"{reading.pixel_size_m:.9e}"
    others = dict(reading.others)
    main = {
        "Date": f"{end:%Y-%m-%d}", "Time": f"{end:%H:%M:%S}.{end.microsecond // 1000:03d}", "Device": device, "ImageStripSize": 0,
        "PixelSizeX": pixel, "PixelSizeY": pixel, "AccFrames": 1,
    }  # fmt: skip
    sem: dict[str, object] = {"DwellTime": f"{reading.dwell_time_s:.9e}"}
    if reading.row_time_s is not None:
        sem["RowTime"] = f"{reading.row_time_s:.9e}"
    keys = {"scan mode": "ScanMode", "detector": "Detector", "rotation": "ScanRotation", "tilt correction": "TiltCorrection"}
    sem |= {key: others[name] for name, key in keys.items() if name in others}
    for key in ("ScanRotation", "TiltCorrection"):
        if key in sem:
            sem[key] = str(sem[key]).split()[0]
    sections = (("MAIN", main), ("SEM", sem))
    return "".join(f"[{name}]\r\n" + "".join(f"{key}={value}\r\n" for key, value in values.items()) for name, values in sections)
