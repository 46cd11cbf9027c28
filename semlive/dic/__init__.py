"""Digital image correlation: from two frames to a disparity map."""

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.data.quality import PatternQuality
from semlive.data.rows import RowShifts
from semlive.data.settings import DicSettings
from semlive.dic.api import match
from semlive.dic.correlate import correlate, warm_up
from semlive.dic.grid import grid_for
from semlive.dic.incremental import begin, composed, follow
from semlive.dic.quality import quality
from semlive.dic.reference import Reference, prepare
from semlive.dic.rest import hold_drift
from semlive.dic.rows import register_rows, row_jitter
from semlive.dic.smear import Smear, correlate_alike, lacking, smear_of
from semlive.dic.tiles import correlate_tiled, is_large

__all__ = [
    "DicSettings",
    "DisparityMap",
    "Grid",
    "PatternQuality",
    "PoiStatus",
    "Reference",
    "RowShifts",
    "Smear",
    "begin",
    "composed",
    "correlate",
    "correlate_alike",
    "correlate_tiled",
    "follow",
    "grid_for",
    "hold_drift",
    "is_large",
    "lacking",
    "match",
    "prepare",
    "quality",
    "register_rows",
    "row_jitter",
    "smear_of",
    "warm_up",
]
