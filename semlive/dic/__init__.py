"""Digital image correlation: from two frames to a disparity map."""

from semlive.data.disparity import DisparityMap, PoiStatus, RowShifts
from semlive.data.frame import PatternQuality
from semlive.data.grid import Grid, grid_for
from semlive.data.settings import DicSettings
from semlive.dic.api import match
from semlive.dic.bands import correlate_tiled, is_large
from semlive.dic.correlate import correlate, warm_up
from semlive.dic.hold_drift import hold_drift
from semlive.dic.image_quality.no_points import NoPointsCause, NoPointsReason, explain_no_points, has_few_points
from semlive.dic.image_quality.quality import quality
from semlive.dic.image_quality.recommendation import CorrelationChoice, recommend
from semlive.dic.incremental import advance, begin, compose_maps
from semlive.dic.integration_blur import IntegrationBlur, blur_of_pair, correlate_with_matched_blur, missing_blur
from semlive.dic.mask import mask_of, moved_mask
from semlive.dic.reference import Reference, prepare
from semlive.dic.row_registration import register_rows, row_jitter

__all__ = [
    "CorrelationChoice",
    "DicSettings",
    "DisparityMap",
    "Grid",
    "IntegrationBlur",
    "NoPointsCause",
    "NoPointsReason",
    "PatternQuality",
    "PoiStatus",
    "Reference",
    "RowShifts",
    "advance",
    "begin",
    "blur_of_pair",
    "compose_maps",
    "correlate",
    "correlate_tiled",
    "correlate_with_matched_blur",
    "explain_no_points",
    "grid_for",
    "has_few_points",
    "hold_drift",
    "is_large",
    "mask_of",
    "match",
    "missing_blur",
    "moved_mask",
    "prepare",
    "quality",
    "recommend",
    "register_rows",
    "row_jitter",
    "warm_up",
]
