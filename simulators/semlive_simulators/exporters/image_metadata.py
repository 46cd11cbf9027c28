"""What an instrument writes beside the pixels, and what it makes of both."""

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
    """What the instrument writes beside the pixels.

    Attributes:
        scan: the raster.
        end_time_ns: when the scan ended by the clock of the microscope's PC, UTC ns.
        stage_x_um: stage position by its own encoder.
        stage_y_um: likewise.
        frame: number of the frame.
        name: of the image file.
        beam_x_um: shift of the beam by the column's own word.
        beam_y_um: likewise.
    """

    scan: Scan
    end_time_ns: int
    stage_x_um: float
    stage_y_um: float
    frame: int
    name: str = ""
    beam_x_um: float = 0.0
    beam_y_um: float = 0.0

    @property
    def end_time(self) -> datetime:
        """End of the scan to the microsecond."""
        return _EPOCH + timedelta(microseconds=self.end_time_ns // 1000)

    @property
    def frames_integrated(self) -> int:
        """Scans of the whole frame that were integrated."""
        return self.scan.integrations if self.scan.integration == "frame" else 1

    @property
    def lines_integrated(self) -> int:
        """Passes over each line that were integrated before the next."""
        return self.scan.integrations if self.scan.integration == "line" else 1

    @property
    def line_time_s(self) -> float:
        """From the start of a line to the start of the next, all passes included, as FEI and Zeiss count."""
        return self.scan.row_time_s * self.lines_integrated

    @property
    def frame_time_s(self) -> float:
        """Of one frame, all passes over its lines included."""
        return self.scan.frame_time_s * self.lines_integrated


@dataclass(frozen=True, slots=True)
class EncodedFrame:
    """The bytes of an exported frame.

    Attributes:
        image: of the image file.
        sidecar: of the text file beside it, if the vendor writes one.
    """

    image: bytes
    sidecar: bytes | None = None
