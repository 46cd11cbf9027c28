"""Digital image correlation: from two frames to a disparity map."""

from semlive.dic.correlate import correlate, warm_up
from semlive.dic.grid import grid_for
from semlive.dic.reference import Reference, prepare

__all__ = ["Reference", "correlate", "grid_for", "prepare", "warm_up"]
