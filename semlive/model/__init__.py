"""Forward model: a tuple of named effects predicts the scan address of each material point.

The measurement model, for frame n, scan address R = (x, y) and time ``t_n(R) = T_n + x t_D + y t_R``::

    R = p_0 + E(R - gamma d) + d(t_n(R)) + A(t_n(R)) (R - c) + l_n(y) + shift_n + G_n (p_0 - c)

p_0 is the ideal position in pair 0. E is the static distortion, fixed at the scan address (gamma = 0) or advected by the drift (gamma = 1).
d is the drift in absolute time, A the slow change of magnification and rotation of the raster, l_n the shift of rows along x in a frame.
shift_n and G_n are the motion of the specimen in the pair of the frame. If the start T_n is uncertain, the second frame of a pair has an
additional drift of d'(t) times the error of its start. Every effect is linear in its parameters and contributes columns of one design
matrix.
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
from semlive.model.walks import Gap, differences_across

__all__ = [
    "Axis",
    "Columns",
    "DistortionSpline",
    "DriftSpline",
    "Effect",
    "FrameObservation",
    "Gap",
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
    "differences_across",
    "evaluate_drift",
    "predicted_offsets",
    "scan_address",
    "sighting",
]
