"""Smear: a frame integrated from several scans shows the speckle at as many places as the drift led it through.

Two frames that drift smeared unequally do not look alike, and no shape function makes them: where frame 0 was smeared by 4 and 6 px
and a frame half an hour later by 1 px, displacements err by 0.03 px, differently from point to point, without any noise. So the
sharper frame is smeared by what it lacks. The drift is read from the frames' own pairs, so nothing needs to be known beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from semlive.data.disparity import DisparityMap
from semlive.data.pair import PairDecision
from semlive.data.settings import DicSettings
from semlive.dic.correlate import correlate
from semlive.dic.reference import Reference
from semlive.dic.uncertainty import interpolation_noise_gain

MIN_BLUR_PX2 = 0.05  # variance of a smear that costs 0.002 px; the Fourier transforms cost a third of a correlation
GREY_HEADROOM = 256  # grey levels of 16 bit for one of 8 bit

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class IntegrationBlur:
    """The scans of a frame lie on a line, equally far apart.

    Attributes:
        step_x_px: from one scan to the next.
        step_y_px: likewise.
        scans: how many.
    """

    step_x_px: float
    step_y_px: float
    scans: int

    @property
    def covariance_px2(self) -> Field:
        """(2, 2) second moments of the places about their mean."""
        step = np.array([self.step_x_px, self.step_y_px])
        return np.outer(step, step) * (self.scans**2 - 1) / 12.0

    def transfer_function(self, shape: tuple[int, int]) -> Field:
        """(height, width // 2 + 1) what the smear leaves of each frequency of a real image."""
        cycles_y, cycles_x = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
        half = np.pi * (cycles_x * self.step_x_px + cycles_y * self.step_y_px)
        below = np.sin(half)
        still = np.abs(below) < 1e-9
        limit = np.cos(self.scans * half) / np.cos(half)  # where both sines vanish
        return np.where(still, limit, np.sin(self.scans * half) / (self.scans * np.where(still, 1.0, below)))


def smear_within(dmap: DisparityMap, apart_s: float, scan_s: float, scans: int) -> IntegrationBlur | None:
    """The smear of a pair's frames, from how far the field went between them; None if that is not known.

    Args:
        dmap: between the frames of a pair, in which nothing but the drift moves.
        apart_s: between their starts.
        scan_s: from one scan to the next.
        scans: that make a frame.
    """
    if apart_s <= 0.0 or not dmap.valid.any():
        return None
    rates = (float(np.median(component[dmap.valid])) / apart_s for component in (dmap.u_px, dmap.v_px))
    step_x_px, step_y_px = (rate * scan_s for rate in rates)
    return IntegrationBlur(step_x_px, step_y_px, scans)


def missing_blur(first: IntegrationBlur | None, second: IntegrationBlur | None) -> IntegrationBlur | None:
    """What the second frame must be smeared by to look like the first; None where that is nothing to speak of.

    Drift keeps its direction better than its speed, so what is missing lies on a line too. A frame that is smeared more than the
    first one is left as it is.
    """
    if first is None or second is None or first.scans < 2:
        return None
    values, vectors = np.linalg.eigh(first.covariance_px2 - second.covariance_px2)
    if values[-1] < MIN_BLUR_PX2:
        return None
    x, y = vectors[:, -1] * np.sqrt(12.0 * values[-1] / (first.scans**2 - 1))
    return IntegrationBlur(float(x), float(y), first.scans)


def blur_of_pair(decision: PairDecision, within: DisparityMap) -> IntegrationBlur | None:
    """How drift smeared a pair's frames, from the map within it; None where a frame is one scan."""
    timing = decision.first.timing
    if timing.integrations.value < 2:
        return None
    apart_s = (decision.second.start_time_ns.value - decision.first.start_time_ns.value) / 1e9
    return smear_within(within, apart_s, timing.frame_time_s.value, timing.integrations.value)


def correlate_with_matched_blur(
    reference: Reference,
    image: NDArray[np.uint8] | NDArray[np.uint16],
    settings: DicSettings,
    smear: IntegrationBlur | None,
    *,
    reference_frame: int,
    current_frame: int,
) -> DisparityMap:
    """`correlate` with the current frame smeared first; addresses within half the smear of the frame's edge are of no use.

    Smearing takes more noise out of the current frame than the displacement is spared, because it is the noise along the
    smeared speckle's own gradients that counts: sigma is stated anew.

    Raises:
        BadInput: the frames differ in size.
        ValueError: not such an image.
    """
    if smear is None:
        return correlate(reference, image, settings, reference_frame=reference_frame, current_frame=current_frame)
    passed = smear.transfer_function(image.shape)
    dmap = correlate(reference, blurred(image, passed), settings, reference_frame=reference_frame, current_frame=current_frame)
    believed = interpolation_noise_gain(dmap.u_px, *_flat(dmap), dmap.grid.subset_px, settings.interpolation)
    believed = believed * interpolation_noise_gain(dmap.v_px, *_flat(dmap), dmap.grid.subset_px, settings.interpolation)
    noise_fraction, felt = _white_left(passed, image.shape), _felt(reference, passed)
    factor = np.sqrt((1.0 + felt) * (1.0 + believed) / (2.0 * (1.0 + noise_fraction)))
    covariance = None if dmap.covariance_px2 is None else dmap.covariance_px2 * factor**2
    return replace(dmap, sigma_u_px=dmap.sigma_u_px * factor, sigma_v_px=dmap.sigma_v_px * factor, covariance_px2=covariance)


def blurred(image: NDArray[np.uint8] | NDArray[np.uint16], passed: Field) -> NDArray[np.uint16]:
    """A frame smeared, in 16 bit, one of 8 bit with its grey levels ROOM times as large."""
    scale = GREY_HEADROOM if image.dtype == np.uint8 else 1
    spectrum = np.asarray(fft.rfft2(image.astype(np.float32))) * passed.astype(np.float32)
    grey = np.asarray(fft.irfft2(spectrum, s=image.shape)) * np.float32(scale)
    return np.clip(np.rint(grey), 0, np.iinfo(np.uint16).max).astype(np.uint16)


def _flat(dmap: DisparityMap) -> tuple[Field, Field]:
    """Gradients of no weight: over a subset they wash sub-pixel phases out by less than 1 %."""
    nothing = np.zeros(dmap.grid.shape)
    return nothing, nothing


def _white_left(passed: Field, shape: tuple[int, int]) -> float:
    """Part of the variance of white noise that is left."""
    return float(np.sum(passed**2 * _twice(shape)) / (shape[0] * shape[1]))


def _felt(reference: Reference, passed: Field) -> float:
    """Part of the smeared frame's noise that the displacement still feels: that along the reference's gradients."""
    twice, retained, total = _twice(reference.shape), 0.0, 0.0
    for gradient in (reference.sums.gradient_x, reference.sums.gradient_y):
        energy = np.abs(np.asarray(fft.rfft2(gradient))) ** 2 * twice
        retained += float(np.sum(energy * passed**2))
        total += float(np.sum(energy))
    return retained / total if total > 0.0 else 1.0


def _twice(shape: tuple[int, int]) -> Field:
    """(1, width // 2 + 1) how often each column of a real image's spectrum stands in the whole one."""
    weight = np.full((1, shape[1] // 2 + 1), 2.0)
    weight[0, 0] = 1.0
    if shape[1] % 2 == 0:
        weight[0, -1] = 1.0
    return weight
