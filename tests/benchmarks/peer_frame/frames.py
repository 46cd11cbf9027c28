"""Small frames of speckle, as the microscope of the configuration exports them, scanned just now."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.microscope.scan import Scan

WIDTH_PX, HEIGHT_PX, SCAN_S = 256, 221, 0.2
_EXPORT = Export(WriteStyle.DIRECT, 0.0, 0.0, 6, 20, "frame", Vendor.FEI)


class FrameWriter:
    """Writes numbered frames of one speckle pattern into the export folder."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._number = folder, 0
        coarse = np.random.default_rng(7).normal(size=(HEIGHT_PX // 3 + 2, WIDTH_PX // 3 + 2))
        self._grey = np.kron(coarse, np.ones((3, 3)))[:HEIGHT_PX, :WIDTH_PX] * 45.0 + 128.0

    def write(self) -> None:
        """A frame whose scan of `SCAN_S` ends now."""
        noise = np.random.default_rng(self._number + 1).normal(size=self._grey.shape) * 2.0
        image = np.clip(self._grey + noise, 1, 254).astype(np.uint8)
        scan = Scan(WIDTH_PX, HEIGHT_PX, 0.8 * SCAN_S / (WIDTH_PX * HEIGHT_PX), SCAN_S, 0.0, 1.0, 1, "frame")
        name = f"frame_{self._number:04d}"
        facts = ImageMetadata(scan, time.time_ns(), 12.5, -3.25, frame=self._number, name=name)
        self._number += 1
        working = self._folder / f"{name}.tmp"
        working.write_bytes(_EXPORT.encode(image, facts).image)
        working.replace(self._folder / f"{name}.tif")
