"""Correlation of frames of any size in bounded memory."""

from semlive.dic.bands.correlation import correlate_tiled, is_large

__all__ = ["correlate_tiled", "is_large"]
