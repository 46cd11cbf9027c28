"""Reason why two frames have no common points, or very few: measured on the frames, with the remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.settings import DicSettings
from semlive.dic.image_quality.frame_comparison import SHADING, Resemblance, compare_frames
from semlive.dic.reference import central_region, noise_of
from semlive.errors import BadInput
from semlive.kernels import images

Image = NDArray[np.uint8] | NDArray[np.uint16]

FEW_POINTS = 0.1  # fraction of the unmasked points; with fewer, the likely cause is reported
DOMINANT = 0.5  # fraction of the points whose status names the cause
LEVEL_PIXELS = 4_000_000  # pixels of which grey levels are counted, to bound the memory
CONSTANT = 0.95  # fraction of the pixels with one grey level: constant, black or saturated
TURN_DEG = 1.0  # smallest reported rotation; the spectra resolve half a degree
SCALE = 0.03  # smallest reported relative change of magnification; the spectra resolve 0.02 in small frames


class NoPointsCause(StrEnum):
    """Why no point was found."""

    MASKED = "masked"
    REFERENCE_CONSTANT = "reference_constant"
    CURRENT_CONSTANT = "current_constant"
    PERIODIC = "periodic"
    THIN_TEXTURE = "thin_texture"
    NEGATIVE = "negative"
    MIRRORED = "mirrored"
    TURNED = "turned"
    ROTATED = "rotated"
    MAGNIFIED = "magnified"
    OUT_OF_RANGE = "out_of_range"
    OTHER_DETECTOR = "other_detector"
    NOISE = "noise"
    CHANGED = "changed"
    UNRELATED = "unrelated"


@dataclass(frozen=True, slots=True)
class NoPointsReason:
    """Reason why two frames have no common points, or very few.

    Attributes:
        cause: kind of the reason, for programs.
        text: what is wrong, with the measured figure.
        remedy: what to do.
    """

    cause: NoPointsCause
    text: str
    remedy: str

    def __str__(self) -> str:
        """One sentence: the reason and the remedy."""
        return f"{self.text}: {self.remedy}"


def has_few_points(disparity: DisparityMap) -> bool:
    """Whether fewer than a tenth of the unmasked points converged."""
    shown = int(np.count_nonzero(disparity.status != PoiStatus.MASKED))
    return int(disparity.valid.sum()) <= FEW_POINTS * shown


def explain_no_points(
    reference: Image, current: Image, disparity: DisparityMap, settings: DicSettings, *, mask: NDArray[np.bool_] | None = None
) -> NoPointsReason:
    """Return the likely cause of a map without points, or with very few, and what would help.

    The cause is measured: contrast of the two frames, status of the points, and agreement of the complete frames after exchange of
    bright and dark, mirroring, rotation, magnification and displacement.

    Args:
        reference: (height, width) uint8 or uint16.
        current: (height, width), of the same size.
        disparity: map of these frames.
        settings: of the correlation.
        mask: (height, width) True where the reference may be used; None: everywhere.

    Raises:
        BadInput: the frames differ in size.
        ValueError: the images have another form.
    """
    if reference.shape != current.shape:
        raise BadInput(f"the reference has the shape {reference.shape} but the current frame {current.shape}: give frames of one size")
    if not (disparity.status != PoiStatus.MASKED).any():
        return NoPointsReason(NoPointsCause.MASKED, "the mask excludes every point", "use a smaller mask (0 where pixels must not be used)")
    for pixels, name, cause in (
        (reference if mask is None else reference[mask], "reference", NoPointsCause.REFERENCE_CONSTANT),
        (current, "current", NoPointsCause.CURRENT_CONSTANT),
    ):
        level, share = _commonest_level(pixels)
        if share >= CONSTANT:
            text = f"the {name} frame has no pattern ({100 * share:.4g} % of its pixels have the grey level {level})"
            return NoPointsReason(cause, text, "check that the beam was on, and brightness and contrast of the detector")
    shares = _shares(disparity)
    if shares[PoiStatus.AMBIGUOUS] >= DOMINANT:
        text = f"the pattern of {100 * shares[PoiStatus.AMBIGUOUS]:.0f} % of the points repeats, so that other positions match as well"
        return NoPointsReason(NoPointsCause.PERIODIC, text, "use a larger subset, or give the largest motion (--search)")
    if shares[PoiStatus.LOW_CONTRAST] >= DOMINANT and reference_is_weak(disparity):
        text = f"{100 * shares[PoiStatus.LOW_CONTRAST]:.0f} % of the points of the reference have too little contrast against noise"
        return NoPointsReason(NoPointsCause.THIN_TEXTURE, text, "use a larger subset or a longer dwell time, or apply a pattern")
    visible = reference if mask is None else np.where(mask, reference, reference.dtype.type(reference[mask].mean()))
    found = compare_frames(visible, current)
    return _transformed(found) or _same_place(found, min(_best_zncc(visible), _best_zncc(current)), disparity, settings, shares)


def reference_is_weak(disparity: DisparityMap) -> bool:
    """Whether points lack contrast before the correlation: such points have no iterations."""
    return disparity.iterations is None or not disparity.iterations[disparity.status == PoiStatus.LOW_CONTRAST].any()


def _shares(disparity: DisparityMap) -> dict[PoiStatus, float]:
    """Fraction of the unmasked points with each status."""
    shown = max(int(np.count_nonzero(disparity.status != PoiStatus.MASKED)), 1)
    return {status: int(np.count_nonzero(disparity.status == status)) / shown for status in PoiStatus}


def _commonest_level(pixels: Image) -> tuple[int, float]:
    """Commonest grey level of an image, and the fraction of the pixels that have it."""
    flat = pixels.ravel()
    counts = np.bincount(flat[:: max(1, flat.size // LEVEL_PIXELS)])
    level = int(np.argmax(counts))
    return level, float(counts[level] / counts.sum())


def _transformed(found: Resemblance) -> NoPointsReason | None:
    """Reason for frames that agree after a change of geometry or contrast; None for frames that agree unchanged, or not at all."""
    if not found.significant:
        return None
    also = ", and it is negative (bright and dark are exchanged)" if found.negative else ""
    words = {
        "mirrored_x": (NoPointsCause.MIRRORED, "mirrored against the reference (left and right are exchanged)"),
        "mirrored_y": (NoPointsCause.MIRRORED, "mirrored against the reference (top and bottom are exchanged)"),
        "transposed": (NoPointsCause.MIRRORED, "mirrored against the reference (rows and columns are exchanged)"),
        "transposed_180": (NoPointsCause.MIRRORED, "mirrored against the reference and turned by 90 degrees"),
        "turned_180": (NoPointsCause.TURNED, "turned by 180 degrees against the reference"),
        "turned_90": (NoPointsCause.TURNED, "turned by 90 degrees counterclockwise against the reference"),
        "turned_270": (NoPointsCause.TURNED, "turned by 90 degrees clockwise against the reference"),
    }
    if found.orientation in words:
        cause, text = words[found.orientation]
        return NoPointsReason(cause, f"the current frame is {text}{also}", "export both frames with the same orientation and scan rotation")
    if found.negative:
        text = "the current frame is the negative of the reference (bright and dark are exchanged)"
        return NoPointsReason(NoPointsCause.NEGATIVE, text, "export both frames with the same polarity of the detector")
    turned, magnified = abs(found.turn_deg) >= TURN_DEG, abs(found.scale - 1.0) >= SCALE
    if magnified:
        turn = f" and turned by {abs(found.turn_deg):.0f} degrees" if turned else ""
        text = f"details of the current frame are about {found.scale:.2f} times as large as in the reference{turn}"
        return NoPointsReason(NoPointsCause.MAGNIFIED, text, "scan both frames with the same magnification, working distance and rotation")
    if turned:
        side = "clockwise" if found.turn_deg > 0.0 else "counterclockwise"
        text = f"the current frame is turned by {abs(found.turn_deg):.0f} degrees {side} against the reference"
        return NoPointsReason(NoPointsCause.ROTATED, text, "scan both frames with the same scan rotation and stage rotation")
    if found.edges_only:
        text = "the edges of both frames agree, but their grey levels do not"
        return NoPointsReason(NoPointsCause.OTHER_DETECTOR, text, "use the same detector, voltage and working distance for both frames")
    return None


def _same_place(
    found: Resemblance,
    weak: float,
    disparity: DisparityMap,
    settings: DicSettings,
    shares: dict[PoiStatus, float],
) -> NoPointsReason:
    """Reason for frames that agree without a change of orientation, or that do not agree.

    Args:
        found: agreement of the complete frames.
        weak: largest correlation that noise permits, of the weaker frame.
        disparity: map of the frames.
        settings: of the correlation.
        shares: fraction of the points with each status.
    """
    if not found.significant:
        if weak < settings.min_zncc:
            text = f"noise hides the pattern: two such frames of one place have a correlation of {max(weak, 0.0):.2f} at most"
            return NoPointsReason(NoPointsCause.NOISE, text, "use a longer dwell time or integrate scans, and check focus and contrast")
        text = "no common pattern was found, also not negative, mirrored, turned or magnified"
        return NoPointsReason(NoPointsCause.UNRELATED, text, "check that both frames show the same place, in focus")
    x, y = found.shift_px
    moved = f"the content of the frame moved by about ({x:+.0f}, {y:+.0f}) px"
    reach = settings.search_px
    if reach is not None and max(abs(x), abs(y)) > reach:
        text = f"{moved}, further than the search range of {reach:g} px"
        return NoPointsReason(NoPointsCause.OUT_OF_RANGE, text, "increase --search, or leave it out")
    common = found.common_fraction
    if shares[PoiStatus.OUTSIDE_IMAGE] + shares[PoiStatus.NO_SEED] >= DOMINANT and common < DOMINANT:
        text = f"{moved}, so that the frames share {100 * common:.0f} % of their area"
        return NoPointsReason(NoPointsCause.OUT_OF_RANGE, text, "move the stage or the beam back, or use a lower magnification")
    if weak < settings.min_zncc:
        text = (
            f"both frames show the same place, but noise limits their correlation to {max(weak, 0.0):.2f} ({settings.min_zncc:g} is needed)"
        )
        return NoPointsReason(NoPointsCause.NOISE, text, "use a longer dwell time, or integrate scans")
    text = (
        f"both frames show the same place ({moved}), but most subsets of {disparity.grid.subset_px} px do not match: "
        "their texture is too thin, or the surface or the scan has changed"
    )
    return NoPointsReason(NoPointsCause.CHANGED, text, "use a larger subset (--subset)")


def _best_zncc(image: Image) -> float:
    """Correlation of two exposures of this frame: variance of the pattern relative to that of pattern and noise."""
    part = images.to_float32_grey(np.ascontiguousarray(image[central_region(image.shape)]))
    variance = float(np.var(part - cv2.GaussianBlur(part, (0, 0), max(part.shape) / SHADING)))
    return 1.0 - noise_of(part) ** 2 / variance if variance > 0.0 else 0.0
