"""The exporter of the bench's own kind of file; see `semlive_simulators.exporters` for all vendors."""

from __future__ import annotations

from semlive_simulators.exporters.facts import ImageFacts
from semlive_simulators.exporters.fei import encode_tiff

__all__ = ["ImageFacts", "encode_tiff"]
