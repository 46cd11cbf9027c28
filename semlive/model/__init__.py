"""Forward model: a tuple of named effects predicts where the beam saw each material point.

The measurement model, for frame n, scan address R = (x, y) and time ``t_n(R) = T_n + x t_D + y t_R``::

    R = p_0 + E(R - gamma d) + d(t_n(R)) + A(t_n(R)) (R - c) + l_n(y) + shift_n + G_n (p_0 - c)

p_0 is the ideal position in pair 0, E the static distortion at the scan address (it stays where the beam is, whatever the
specimen does, gamma = 0, or is carried along by the drift, gamma = 1), d the drift in absolute time, A magnification and
rotation of the raster that wander, l_n the shift of rows along x in a frame, shift_n and G_n the motion of the specimen in the
frame's pair. Where the start T_n is not known exactly, the drift that a pair's second frame shows is d'(t) times the start's error further
on. Every effect is linear in its own parameters and contributes columns of one design matrix.
"""

from semlive.model.distortion import DistortionSpline
from semlive.model.drift import DriftSpline
from semlive.model.effect import Axis, Columns, Effect, FrameObservation, Layout, TensorColumns
from semlive.model.forward import evaluate_drift, predicted_offsets, scan_address
from semlive.model.motion import MotionKind, PairMotions
from semlive.model.raster_drift import RasterChange, RasterTerm
from semlive.model.raster_time import sighting
from semlive.model.row_shift import RowShiftEffect
from semlive.model.scan_axes import ScanAxes
from semlive.model.splines import UniformSpline
from semlive.model.start_time_error import StartTimeErrors

__all__ = [
    "Axis",
    "Columns",
    "DistortionSpline",
    "DriftSpline",
    "Effect",
    "FrameObservation",
    "Layout",
    "MotionKind",
    "PairMotions",
    "RasterChange",
    "RasterTerm",
    "RowShiftEffect",
    "ScanAxes",
    "StartTimeErrors",
    "TensorColumns",
    "UniformSpline",
    "evaluate_drift",
    "predicted_offsets",
    "scan_address",
    "sighting",
]
