"""Metadata of an exported image, and its encoded files."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.microscope.scan import Scan

Pixels = NDArray[np.unsignedinteger]
"""A grey image of 8 or 16 bit, (height, width)."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class ImageMetadata:
    """Metadata that the instrument writes with the pixels.

    Attributes:
        scan: the raster.
        end_time_ns: end of the scan on the clock of the microscope PC, UTC ns.
        stage_x_um: stage position of the encoder, um.
        stage_y_um: likewise.
        frame: number of the frame.
        name: name of the image file.
        beam_x_um: beam shift that the column reports, um.
        beam_y_um: likewise.
        row_start_s: start of each row by the clock of the instrument, s since the scan began; empty without such a clock.
    """

    scan: Scan
    end_time_ns: int
    stage_x_um: float
    stage_y_um: float
    frame: int
    name: str = ""
    beam_x_um: float = 0.0
    beam_y_um: float = 0.0
    row_start_s: tuple[float, ...] = ()

    @property
    def end_time(self) -> datetime:
        """End of the scan to the microsecond."""
        return _EPOCH + timedelta(microseconds=self.end_time_ns // 1000)

    @property
    def frames_integrated(self) -> int:
        """Number of integrated scans of the complete frame."""
        return self.scan.integrations if self.scan.integration == "frame" else 1

    @property
    def lines_integrated(self) -> int:
        """Number of integrated scans of each line."""
        return self.scan.integrations if self.scan.integration == "line" else 1

    @property
    def line_time_s(self) -> float:
        """Time from the start of a line to the start of the next, with all its scans, as in files of FEI and Zeiss."""
        return self.scan.row_time_s * self.lines_integrated

    @property
    def frame_time_s(self) -> float:
        """Time of one frame with all scans of its lines."""
        return self.scan.frame_time_s * self.lines_integrated


@dataclass(frozen=True, slots=True)
class EncodedFrame:
    """The bytes of an exported frame.

    Attributes:
        image: content of the image file.
        sidecar: content of the text file; None if the vendor writes none.
    """

    image: bytes
    sidecar: bytes | None = None
