"""Settings of the analysis as plain values, made from the checked configuration file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from semlive.data.diagnosis.effects import EMPTY_MODEL, EffectModel

RowClockUse = Literal["if_present", "awaited", "required"]
"""Text file with the row starts of an instrument's own clock: used if it came before its image; awaited, and the image used without it; or
awaited, and the image rejected without it."""


@dataclass(frozen=True, slots=True)
class DicSettings:
    """Settings of the correlation.

    Attributes:
        subset_px: edge of the square subset, odd.
        step_px: distance of neighbouring POI.
        roi_px: first and last possible subset centres (x0, y0, x1, y1), inclusive; None covers the frame.
        max_iterations: maximum number of IC-GN iterations of a POI.
        tolerance_px: IC-GN stops when the next update is expected to move no subset corner by more than this.
        min_zncc: smallest ZNCC of a valid POI.
        interpolation: B-spline of the current image: ``cubic`` or ``quintic`` (a third of the bias, twice the time).
        shape_function: shape function of a subset: ``affine``, ``quadratic`` (resolves periods of 1.3 instead of 4 subsets, twice the
            noise) or ``quartic`` (0.7 subsets, three times the noise; a subset 1.75 times as large replaces a quadratic one).
        min_valid_fraction: smallest unmasked fraction of a subset that is measured.
        search_px: largest possible motion of a point along x or y; None if unknown. It limits the search for initial guesses, and a
            pattern with a period of more than twice this distance is not ambiguous.
        method: ``subset``; ``global``: one regularised field for the frame, for weak texture and rasters with row errors; ``auto``:
            subsets, and the global method where they measure too few points.
        mask: PNG file with 0 where frame 0 must not be used, and other values elsewhere, of the size of a frame without its databar. In a
            configuration file it is the path; settings of a run contain the bytes of the file as text (`semlive.inputs.mask_file`).
    """

    subset_px: int = 43
    step_px: int = 5
    roi_px: tuple[int, int, int, int] | None = (101, 101, 846, 696)
    max_iterations: int = 30
    tolerance_px: float = 1e-3
    min_zncc: float = 0.7
    interpolation: Literal["cubic", "quintic"] = "cubic"
    shape_function: Literal["affine", "quadratic", "quartic"] = "affine"
    min_valid_fraction: float = 0.5
    search_px: float | None = None
    method: Literal["auto", "subset", "global"] = "auto"
    mask: str | None = None

    def __post_init__(self) -> None:
        if self.subset_px < 5 or self.subset_px % 2 == 0:
            raise ValueError(f"subset_px must be odd and at least 5, not {self.subset_px}")
        if self.step_px < 1:
            raise ValueError(f"step_px must be at least 1, not {self.step_px}")
        if self.interpolation not in ("cubic", "quintic"):
            raise ValueError(f"interpolation must be cubic or quintic, not {self.interpolation}")
        if self.shape_function not in ("affine", "quadratic", "quartic"):
            raise ValueError(f"shape_function must be affine, quadratic or quartic, not {self.shape_function}")
        if not 0.0 < self.min_valid_fraction <= 1.0:
            raise ValueError(f"min_valid_fraction must be above 0 and at most 1, not {self.min_valid_fraction}")
        if self.method not in ("auto", "subset", "global"):
            raise ValueError(f"method must be auto, subset or global, not {self.method}")
        if self.search_px is not None and not self.search_px > 0.0:
            raise ValueError(f"search_px must be above 0, not {self.search_px}")


MEASURES = {"engineering": "engineering small strain", "green_lagrange": "Green-Lagrange strain"}
"""Names of the strain measures in texts."""


@dataclass(frozen=True, slots=True)
class StrainSettings:
    """Settings of the virtual strain gauge.

    Attributes:
        order: order of the local polynomial, 1 or 2.
        weights: weights within the window: ``uniform``, or ``gaussian`` (smoother; needs a longer window for the same noise).
        measure: strain measure: ``engineering`` small strain, or ``green_lagrange``.
        butterworth_points: cut-off wavelength, in POI, of the low-pass filter before the fit, as published; None: no filter.
    """

    order: int = 1
    weights: Literal["uniform", "gaussian"] = "uniform"
    measure: Literal["engineering", "green_lagrange"] = "engineering"
    butterworth_points: float | None = None

    def __post_init__(self) -> None:
        if self.order not in (1, 2):
            raise ValueError(f"order must be 1 or 2, not {self.order}")
        if self.weights not in ("uniform", "gaussian"):
            raise ValueError(f"weights must be uniform or gaussian, not {self.weights}")
        if self.measure not in MEASURES:
            raise ValueError(f"measure must be engineering or green_lagrange, not {self.measure}")
        if self.butterworth_points is not None and not self.butterworth_points > 2:
            raise ValueError(f"butterworth_points must be above 2, not {self.butterworth_points}")


@dataclass(frozen=True, slots=True)
class EstimateSettings:
    """Settings of the estimate of drift and distortion.

    Attributes:
        drift_knots_per_frame: number of knots of the drift spline per frame time.
        distortion_knot_px: knot distance of the distortion spline.
        window_points: edge of the virtual strain gauge in POI.
        method: method of estimation: ``joint``, or ``sutton2007`` for the published procedure.
        sutton_smoothing_px: standard deviation of the Gaussian that smooths local drift over positions in ``sutton2007``; the paper
            mentions none, but its figures are not reached without it.
        strain: settings of the virtual strain gauge.
        sutton_phases_apart: whether ``sutton2007`` estimates the drift of calibration and measurement separately (footnote 5).
        accept_poor_calibration: load the specimen and correct the maps under load although the translations have one direction only or
            are too small.
        max_blocks: largest number of blocks of points that the joint method takes the mean of, about; 0: blocks as large as a subset.
            `semlive diagnose` uses at most 300.
    """

    drift_knots_per_frame: float = 3.0
    distortion_knot_px: float = 100.0
    window_points: int = 9
    method: str = "joint"
    sutton_smoothing_px: float = 60.0
    sutton_phases_apart: bool = True
    strain: StrainSettings = StrainSettings()
    accept_poor_calibration: bool = False
    max_blocks: int = 0

    def __post_init__(self) -> None:
        if self.max_blocks < 0:
            raise ValueError(f"max_blocks must be at least 0, not {self.max_blocks}")
        if self.method not in ("joint", "sutton2007"):
            raise ValueError(f"method must be joint or sutton2007, not {self.method}")
        if not self.sutton_smoothing_px >= 0:
            raise ValueError(f"sutton_smoothing_px must be at least 0, not {self.sutton_smoothing_px}")


@dataclass(frozen=True, slots=True)
class SpecimenSettings:
    """Properties of the specimen.

    Attributes:
        name: free text.
        area_mm2: cross-section; None if unknown, without elastic constants.
        loading_axis: image axis of the load, ``x`` or ``y``.
        gage_factor_sigma: relative standard uncertainty of the gage factor of a strain gage; data sheets give 0.5 to 1 %.
        yield_strength_mpa: maximum stress of the plan; None: not checked.
    """

    name: str = ""
    area_mm2: float | None = None
    loading_axis: str = "y"
    gage_factor_sigma: float = 0.005
    yield_strength_mpa: float | None = None

    def __post_init__(self) -> None:
        if self.loading_axis not in ("x", "y"):
            raise ValueError(f"loading_axis must be x or y, not {self.loading_axis}")
        if self.area_mm2 is not None and not self.area_mm2 > 0:
            raise ValueError(f"area_mm2 must be > 0, not {self.area_mm2}")
        if not 0.0 <= self.gage_factor_sigma < 1.0:
            raise ValueError(f"gage_factor_sigma must be at least 0 and below 1, not {self.gage_factor_sigma}")
        if self.yield_strength_mpa is not None and not self.yield_strength_mpa > 0:
            raise ValueError(f"yield_strength_mpa must be > 0, not {self.yield_strength_mpa}")


@dataclass(frozen=True, slots=True)
class ScanSpeed:
    """Scan times for one scan speed of a microscope; one entry of ``sem.scan_profiles``.

    Attributes:
        scan_speed: name or number of the scan speed in the files of the vendor.
        instrument: beginning of the name of the instrument in the file; empty matches all.
        width_px: image width to which the times apply; None: every width (with equal row times).
        dwell_time_s: time on one pixel in one pass.
        row_time_s: time from the start of one row to the next, all passes and fly-backs included.
        frame_time_s: duration of one scan.
    """

    scan_speed: str
    instrument: str = ""
    width_px: int | None = None
    dwell_time_s: float | None = None
    row_time_s: float | None = None
    frame_time_s: float | None = None

    def fits(self, instrument: str, scan_speed: str, width_px: int) -> bool:
        """Whether the entry applies to a file."""
        named = scan_speed != "" and self.scan_speed == scan_speed
        return named and instrument.startswith(self.instrument) and self.width_px in (None, width_px)


@dataclass(frozen=True, slots=True)
class ScanProfile:
    """Values for files whose headers lack them.

    Attributes:
        start_anchor: meaning of the time in a file: ``start`` or ``end`` of the scan, or ``save`` (`save_delay_s` after the end).
        start_sigma_s: standard uncertainty of the start time that is derived from it.
        dwell_time_s: time on one pixel, for files without it.
        row_time_s: time from the start of one row to the next, for files without it.
        frame_time_s: duration of one scan, for files without it.
        pixel_size_m: edge of a pixel, for files without it.
        databar_rows: rows of the databar, for files without it; None: no databar.
        clock_offset_s: clock of the computer of the microscope minus UTC, time zone included; it is subtracted from times in files.
        save_delay_s: delay from the end of a scan to the time in the file, for ``save``.
        field_width_mm_at_1x: calibrated width of the field at magnification 1; gives the pixel size of files without it.
        speeds: scan times by scan speed; they take precedence over the values above.
        page: which image of a TIFF file with several images is the frame, from 1; None if each file contains one frame.
    """

    start_anchor: str = "end"
    start_sigma_s: float = 0.3
    dwell_time_s: float | None = None
    row_time_s: float | None = None
    frame_time_s: float | None = None
    pixel_size_m: float | None = None
    databar_rows: int | None = None
    clock_offset_s: float = 0.0
    save_delay_s: float = 0.0
    field_width_mm_at_1x: float | None = None
    speeds: tuple[ScanSpeed, ...] = ()
    page: int | None = None

    def __post_init__(self) -> None:
        if self.page is not None and self.page < 1:
            raise ValueError(f"page must be at least 1, not {self.page}")
        if self.start_anchor not in ("start", "end", "save"):
            raise ValueError(f"start_anchor must be start, end or save, not {self.start_anchor}")
        if not self.start_sigma_s >= 0:
            raise ValueError(f"start_sigma_s must be at least 0, not {self.start_sigma_s}")


@dataclass(frozen=True, slots=True)
class AnalysisSettings:
    """Settings of the pipeline."""

    dic: DicSettings = DicSettings()
    estimate: EstimateSettings = EstimateSettings()
    specimen: SpecimenSettings = SpecimenSettings()
    scan: ScanProfile = ScanProfile()
    model: EffectModel = EMPTY_MODEL
