"""Displacement and strain fields, their summary, the elastic constants and the comparison with a strain gage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid


@dataclass(frozen=True, slots=True, eq=False)
class StrainField:
    """Engineering small strain of a frame relative to frame 0, positive in tension.

    ``exx = du/dx, eyy = dv/dy, exy = (du/dy + dv/dx) / 2`` (tensor shear).

    Attributes:
        frame: number of the frame.
        grid: the POI, in frame 0.
        window_points: edge of the virtual strain gauge in POI.
        exx: (ny, nx), zero where not valid.
        eyy: (ny, nx), zero where not valid.
        exy: (ny, nx), zero where not valid.
        valid: (ny, nx) True where the gauge had enough valid points.
    """

    frame: int
    grid: Grid
    window_points: int
    exx: NDArray[np.float64]
    eyy: NDArray[np.float64]
    exy: NDArray[np.float64]
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Tensor2:
    """Three in-plane components of a strain quantity: mean, standard uncertainty or standard deviation."""

    exx: float
    eyy: float
    exy: float


@dataclass(frozen=True, slots=True)
class StrainSummary:
    """Strain of one frame over the valid grid.

    Attributes:
        frame: number of the frame.
        mean: mean over the valid grid.
        mean_sigma: standard uncertainty of the mean.
        sd: standard deviation over the valid grid, for the gauge in `vsg_px`.
        vsg_px: edge of the virtual strain gauge.
        gauge_sigma: standard uncertainty of the strain of one complete gauge; None if unknown.
        systematic_sigma: part of `mean_sigma` and of `gauge_sigma` by the correction: common to all points of the frame, so averaging
            does not reduce it. The other part is the noise of the correlation. None if unknown.
    """

    frame: int
    mean: Tensor2
    mean_sigma: Tensor2
    sd: Tensor2
    vsg_px: float
    gauge_sigma: Tensor2 | None = None
    systematic_sigma: Tensor2 | None = None


@dataclass(frozen=True, slots=True)
class MeasuredValue:
    """A number with its standard uncertainty."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True)
class ElasticConstants:
    """Young's modulus and Poisson's ratio from the load steps.

    Attributes:
        youngs_modulus_gpa: slope of stress over axial strain.
        poissons_ratio: minus the slope of transverse over axial strain.
    """

    youngs_modulus_gpa: MeasuredValue
    poissons_ratio: MeasuredValue


@dataclass(frozen=True, slots=True)
class GageStep:
    """One load step by the strain gage and by DIC, along the load.

    Attributes:
        pair: number of the pair.
        load_n: mean load over both frames.
        gage_strain: by the gage, from its own zero.
        gage_sigma: standard uncertainty from the scatter of its readings.
        dic_strain: by DIC, from frame 0.
        dic_sigma: standard uncertainty.
    """

    pair: int
    load_n: float
    gage_strain: float
    gage_sigma: float
    dic_strain: float
    dic_sigma: float


@dataclass(frozen=True, slots=True)
class StrainGageComparison:
    """Comparison of DIC with a strain gage on the same specimen; all values are slopes, independent of zero offsets.

    Attributes:
        steps: load steps with data of DIC and gage.
        youngs_modulus_gpa: slope of stress over the gage's strain.
        poissons_ratio: minus the slope of DIC's transverse strain over the gage's.
        dic_over_gage: slope of DIC's axial strain over the gage's; 1 if both are correct.
    """

    steps: tuple[GageStep, ...]
    youngs_modulus_gpa: MeasuredValue
    poissons_ratio: MeasuredValue
    dic_over_gage: MeasuredValue


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """Displacement of the specimen from frame 0 to a frame, on the reference grid.

    Attributes:
        frame: number of the frame.
        grid: the POI, in frame 0.
        u_px: (ny, nx) along x; zero where not valid.
        v_px: (ny, nx) along y; zero where not valid.
        sigma_u_px: (ny, nx) standard uncertainty along x.
        sigma_v_px: (ny, nx) standard uncertainty along y.
        valid: (ny, nx) True where displacement was measured.
        systematic_u_px: (ny, nx) standard uncertainty along x by the correction, without its mean over the field; None where it was not
            requested, or the method has no estimate.
        systematic_v_px: (ny, nx) likewise along y.
    """

    frame: int
    grid: Grid
    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    sigma_u_px: NDArray[np.float64]
    sigma_v_px: NDArray[np.float64]
    valid: NDArray[np.bool_]
    systematic_u_px: NDArray[np.float64] | None = None
    systematic_v_px: NDArray[np.float64] | None = None
