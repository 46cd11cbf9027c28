"""Blur by integration: a frame that is the mean of several scans contains the speckle at each position that the drift reached.

Two frames with unequal blur differ in a way that no shape function describes. Example: with a blur of 4 and 6 px in frame 0 and of
1 px half an hour later, displacements have errors of 0.03 px that vary from point to point, without any noise. Therefore the sharper
frame is blurred by the difference. The drift is measured between the two frames of each pair.
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

MIN_BLUR_PX2 = 0.05  # variance of a blur that causes an error of 0.002 px; its correction takes a third of the time of a correlation
GREY_HEADROOM = 256  # 16-bit grey levels per 8-bit grey level

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class IntegrationBlur:
    """Blur by scans at equal distances on a line.

    Attributes:
        step_x_px: displacement along x from one scan to the next.
        step_y_px: displacement along y from one scan to the next.
        scans: number of scans.
    """

    step_x_px: float
    step_y_px: float
    scans: int

    @property
    def covariance_px2(self) -> Field:
        """(2, 2) covariance of the positions of the scans."""
        step = np.array([self.step_x_px, self.step_y_px])
        return np.outer(step, step) * (self.scans**2 - 1) / 12.0

    def transfer_function(self, shape: tuple[int, int]) -> Field:
        """(height, width // 2 + 1) transfer function of the blur for the half spectrum of a real image."""
        cycles_y, cycles_x = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
        half_phase = np.pi * (cycles_x * self.step_x_px + cycles_y * self.step_y_px)
        sine = np.sin(half_phase)
        small = np.abs(sine) < 1e-9
        limit = np.cos(self.scans * half_phase) / np.cos(half_phase)  # limit where both sines are zero
        return np.where(small, limit, np.sin(self.scans * half_phase) / (self.scans * np.where(small, 1.0, sine)))


def blur_within_pair(dmap: DisparityMap, interval_s: float, scan_s: float, scans: int) -> IntegrationBlur | None:
    """Blur of the frames of a pair from the drift between them; None if the drift is unknown.

    Args:
        dmap: map between the frames of a pair, which contains drift only.
        interval_s: time between the starts of the two frames.
        scan_s: time from the start of one scan to the next.
        scans: number of scans per frame.
    """
    if interval_s <= 0.0 or not dmap.valid.any():
        return None
    rates = (float(np.median(component[dmap.valid])) / interval_s for component in (dmap.u_px, dmap.v_px))
    step_x_px, step_y_px = (rate * scan_s for rate in rates)
    return IntegrationBlur(step_x_px, step_y_px, scans)


def missing_blur(first: IntegrationBlur | None, second: IntegrationBlur | None) -> IntegrationBlur | None:
    """Blur that the second frame lacks in comparison with the first; None if it is negligible.

    The direction of drift changes less than its speed, so the missing blur is along a line, too. A frame with more blur than the
    first one is not changed.
    """
    if first is None or second is None or first.scans < 2:
        return None
    values, vectors = np.linalg.eigh(first.covariance_px2 - second.covariance_px2)
    if values[-1] < MIN_BLUR_PX2:
        return None
    x, y = vectors[:, -1] * np.sqrt(12.0 * values[-1] / (first.scans**2 - 1))
    return IntegrationBlur(float(x), float(y), first.scans)


def blur_of_pair(decision: PairDecision, within: DisparityMap) -> IntegrationBlur | None:
    """Blur of the frames of a pair by drift, from the map between them; None if a frame is a single scan."""
    timing = decision.first.timing
    if timing.integrations.value < 2:
        return None
    interval_s = (decision.second.start_time_ns.value - decision.first.start_time_ns.value) / 1e9
    return blur_within_pair(within, interval_s, timing.frame_time_s.value, timing.integrations.value)


def correlate_with_matched_blur(
    reference: Reference,
    image: NDArray[np.uint8] | NDArray[np.uint16],
    settings: DicSettings,
    blur: IntegrationBlur | None,
    *,
    reference_frame: int,
    current_frame: int,
) -> DisparityMap:
    """Correlate after blurring the current frame; points within half the blur of the edge of the frame are unreliable.

    The blur removes more noise from the image than from the displacement, which depends on the noise along the gradients of the
    blurred speckle. Therefore the standard uncertainties are corrected.

    Raises:
        BadInput: the frames differ in size.
        ValueError: the image has another form.
    """
    if blur is None:
        return correlate(reference, image, settings, reference_frame=reference_frame, current_frame=current_frame)
    transfer = blur.transfer_function(image.shape)
    dmap = correlate(reference, blurred(image, transfer), settings, reference_frame=reference_frame, current_frame=current_frame)
    assumed = interpolation_noise_gain(dmap.u_px, *_flat(dmap), dmap.grid.subset_px, settings.interpolation)
    assumed = assumed * interpolation_noise_gain(dmap.v_px, *_flat(dmap), dmap.grid.subset_px, settings.interpolation)
    noise_fraction, effective = _noise_fraction(transfer, image.shape), _effective_noise_fraction(reference, transfer)
    factor = np.sqrt((1.0 + effective) * (1.0 + assumed) / (2.0 * (1.0 + noise_fraction)))
    covariance = None if dmap.covariance_px2 is None else dmap.covariance_px2 * factor**2
    return replace(dmap, sigma_u_px=dmap.sigma_u_px * factor, sigma_v_px=dmap.sigma_v_px * factor, covariance_px2=covariance)


def blurred(image: NDArray[np.uint8] | NDArray[np.uint16], transfer: Field) -> NDArray[np.uint16]:
    """Blurred frame in 16 bit; grey levels of an 8-bit frame are multiplied by GREY_HEADROOM."""
    scale = GREY_HEADROOM if image.dtype == np.uint8 else 1
    spectrum = np.asarray(fft.rfft2(image.astype(np.float32))) * transfer.astype(np.float32)
    grey = np.asarray(fft.irfft2(spectrum, s=image.shape)) * np.float32(scale)
    return np.clip(np.rint(grey), 0, np.iinfo(np.uint16).max).astype(np.uint16)


def _flat(dmap: DisparityMap) -> tuple[Field, Field]:
    """Zero gradients: within a subset, real ones change the sub-pixel phases by less than 1 %."""
    zero = np.zeros(dmap.grid.shape)
    return zero, zero


def _noise_fraction(transfer: Field, shape: tuple[int, int]) -> float:
    """Fraction of the variance of white noise that remains after the blur."""
    return float(np.sum(transfer**2 * _column_weights(shape)) / (shape[0] * shape[1]))


def _effective_noise_fraction(reference: Reference, transfer: Field) -> float:
    """Fraction of the noise variance of the blurred frame along the gradients of the reference, which affects displacements."""
    weights, retained, total = _column_weights(reference.shape), 0.0, 0.0
    for gradient in (reference.sums.gradient_x, reference.sums.gradient_y):
        energy = np.abs(np.asarray(fft.rfft2(gradient))) ** 2 * weights
        retained += float(np.sum(energy * transfer**2))
        total += float(np.sum(energy))
    return retained / total if total > 0.0 else 1.0


def _column_weights(shape: tuple[int, int]) -> Field:
    """(1, width // 2 + 1) multiplicity of each column of a half spectrum in the full spectrum of a real image."""
    weight = np.full((1, shape[1] // 2 + 1), 2.0)
    weight[0, 0] = 1.0
    if shape[1] % 2 == 0:
        weight[0, -1] = 1.0
    return weight
