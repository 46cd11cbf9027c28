"""The image of a frame from messages of its data connection, and the row time from their arrival."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.errors import LinkError
from semlive_drivers.microscope.sharksem.messages import ScanData

_MIN_MESSAGES = 5
_MIN_COVERED = 0.5
"""Smallest part of a frame between first and last message from which the row time is measured."""


class FrameAssembly:
    """Pixels of one frame and one channel, received in messages of any length.

    Data of other frames and channels are ignored: the server may still send those of an earlier scan (manual, ScStopScan). Pixels that
    arrive again replace the earlier ones, as TESCAN's own client does.

    Args:
        frame: identification of the frame.
        channel: video channel.
        width: columns.
        height: rows.
        bits: 8 or 16 bits per pixel.
    """

    def __init__(self, frame: int, channel: int, width: int, height: int, bits: int) -> None:
        self._frame, self._channel, self._bits = frame, channel, bits
        self._shape = (height, width)
        # 16-bit data are little endian by the manual; a public client (delmic/odemis) reads them as big endian.
        self._pixels = np.zeros(height * width, dtype=np.uint8 if bits == 8 else np.dtype("<u2"))
        self._received = np.zeros(height * width, dtype=np.bool_)
        self._arrivals: list[tuple[int, float]] = []

    @property
    def missing(self) -> int:
        """Number of pixels that have not arrived."""
        return int(self._received.size - np.count_nonzero(self._received))

    def add(self, data: ScanData, arrival_s: float) -> None:
        """Store the pixels of a message.

        Args:
            data: the message.
            arrival_s: monotonic clock when it arrived, s.

        Raises:
            LinkError: its pixels have other bits, or lie outside the frame.
        """
        if (data.frame, data.channel) != (self._frame, self._channel):
            return
        if data.bits != self._bits:
            raise LinkError(f"sent pixels of {data.bits} bit instead of {self._bits}")
        pixels = np.frombuffer(data.pixels[: len(data.pixels) // self._pixels.itemsize * self._pixels.itemsize], self._pixels.dtype)
        end = data.index + len(pixels)
        if end > self._pixels.size:
            raise LinkError(f"sent pixels up to number {end} of a frame of {self._pixels.size}")
        self._pixels[data.index : end] = pixels
        self._received[data.index : end] = True
        self._arrivals.append((end, arrival_s))

    def image(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Return the pixels received, (height, width)."""
        return self._pixels.reshape(self._shape)

    def row_time_s(self) -> float | None:
        """Return the row time from a straight line through the arrivals, s; None if they are too few."""
        ends, times = (np.array(values, dtype=np.float64) for values in zip(*self._arrivals, strict=True)) if self._arrivals else ((), ())
        if len(ends) < _MIN_MESSAGES or np.ptp(ends) < _MIN_COVERED * self._pixels.size:
            return None
        slope_s = np.polynomial.polynomial.polyfit(ends, times, 1)[1]
        return float(slope_s * self._shape[1]) if slope_s > 0 else None
