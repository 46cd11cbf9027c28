"""The exporter of the bench's own kind of file; see `semlive_simulators.exporters` for all vendors."""

from __future__ import annotations

from semlive_simulators.exporters.fei import encode_tiff
from semlive_simulators.exporters.image_metadata import ImageMetadata

__all__ = ["ImageMetadata", "encode_tiff"]
