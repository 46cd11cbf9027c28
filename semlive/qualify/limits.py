"""What limits the strain: the error by each source, without and with the corrections of a run, and its remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from semlive.data.diagnosis.effects import IdentifiedEffect
from semlive.qualify.values import Limit

REFERENCE_SHIFT_PX = 5.0
"""Shift of the specimen between frames for which false strain is stated, as in figure 16 of Sutton et al. (2007)."""
MIN_EXCESS = 1.15
"""Smallest ratio of the measured noise to that of the image for which a further source is named: both are determined to 5 %."""
MIN_SETTLING_SHARE = 0.5
STRAINLESS = ("stage_yaw", "raster_rotation_drift", "drift_jump", "jump_within_pair", "thermal_oscillation", "dic_subpixel_bias")
"""Effects that turn or shift the image, or points of equal motion, alike: they have no strain, or that of the drift."""

REMEDIES = {
    "image_noise": "raise the dwell time or the beam current, take a larger gauge, or improve the contrast of the pattern",
    "unexplained_noise": "take pairs with another dwell time, and search for vibration, charging and a changing surface",
    "drift": "wait longer before the first pair, scan faster, and keep the correction of drift",
    "distortion": "calibrate with the recommended shifts and keep the correction of distortion, or keep the specimen in place",
    "row_start_settling": "omit the first columns of the frame, scan slower or calibrate; its law needs a second dwell and magnification",
    "stage": "approach each position from the same side, use beam shift for small moves, and let semlive measure the shifts",
    "mains_hum": "synchronise rows with the mains, move mains cables and transformers away, or check the grounding",
    "vibration": "find the source at this frequency, for example pumps and ventilation, and isolate the column",
    "row_jitter": "check the scan generator and its synchronisation; a longer dwell averages it",
    "wrong_row_time": "measure the row time, for example with mains hum or an oscilloscope, and set it in sem.profile",
}
_OTHER_REMEDY = "run `semlive experiment propose` on a log of this microscope, which separates this effect from similar ones"


@dataclass(frozen=True, slots=True)
class Sources:
    """What the limits are derived from; zero for what is not determined.

    Attributes:
        noise: standard deviation of strain at the reference gauge, measured.
        image_share: ratio of the displacement noise of the image to the measured one, 0 to 1.
        drift_strain: false strain by drift within a frame.
        drift_strain_sigma: its standard uncertainty.
        false_strain_per_px: largest false strain by distortion per px of shift.
        false_strain_sigma_per_px: its standard uncertainty at one place.
        row_start_per_px: false strain by settling at the row start per px of shift.
        stage_residual_px: error of a stage move.
        half_frame_px: half of the shorter edge of the frame.
        row_effects: effects of the rows.
        map_effects: effects of the maps.
    """

    noise: float
    image_share: float
    drift_strain: float
    drift_strain_sigma: float
    false_strain_per_px: float
    false_strain_sigma_per_px: float
    row_start_per_px: float
    stage_residual_px: float
    half_frame_px: float
    row_effects: Sequence[IdentifiedEffect] = ()
    map_effects: Sequence[IdentifiedEffect] = ()


def limits_of(sources: Sources) -> tuple[Limit, ...]:
    """Sources of strain error, the largest without correction first."""
    share = min(sources.image_share, 1.0)
    image = sources.noise * share if share * MIN_EXCESS < 1.0 else sources.noise
    found = [("image_noise", image, image)]
    if share * MIN_EXCESS < 1.0:
        further = sources.noise * (1.0 - share**2) ** 0.5
        largest = max(sources.row_effects, key=lambda effect: effect.peak_px, default=None)
        found.append(("unexplained_noise" if largest is None else largest.name, further, further))
    found.append(("drift", sources.drift_strain, sources.drift_strain_sigma))
    per_px, sigma_per_px = sources.false_strain_per_px, sources.false_strain_sigma_per_px
    settles = sources.row_start_per_px > MIN_SETTLING_SHARE * per_px > 0.0
    bent = "row_start_settling" if settles else "distortion"
    found.append((bent, REFERENCE_SHIFT_PX * per_px, REFERENCE_SHIFT_PX * sigma_per_px))
    found.append(("stage", sources.stage_residual_px * per_px, sources.stage_residual_px * sigma_per_px))
    for effect in (effect for effect in sources.map_effects if effect.name not in STRAINLESS):
        bias = effect.peak_px / sources.half_frame_px
        found.append((effect.name, bias, bias))
    limits = [Limit(name, strain, corrected, REMEDIES.get(name, _OTHER_REMEDY)) for name, strain, corrected in found if strain > 0.0]
    return tuple(sorted(limits, key=lambda limit: -limit.strain))


def largest_corrected(limits: Sequence[Limit]) -> str:
    """Name of the limit that is largest after correction; empty without limits."""
    return max(limits, key=lambda limit: limit.strain_corrected).name if limits else ""
