"""Global, regularised correlation with unknowns of each row, for weak texture and rasters with row errors."""

from semlive.dic.global_method.measure import measure

__all__ = ["measure"]
