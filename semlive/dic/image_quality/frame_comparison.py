"""Comparison of two complete frames: the geometric change or the change of contrast after which they correlate.

A frame pair without matching points is compared in one piece. The phase correlation of the low-passed frames has a peak if both show
the same place. The peak is expressed in standard deviations of the surface. It counts only if the cross-correlation at the same shift is
high, too: structure that is not white, such as grains and shading, raises the phase correlation of unrelated frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from semlive.dic.initial_guess.fft_windows import low_pass
from semlive.dic.initial_guess.frame_shift import LOW_PASS

Image = NDArray[np.uint8] | NDArray[np.uint16]
Grey = NDArray[np.float32]

COARSE_PX = 512  # largest edge of the frames that are compared
DETAIL_PX = 1024  # edge of the central part of a larger frame, which is compared with less binning
SIGNIFICANT_PEAK = 18.0  # standard deviations; at most 17.2 for 120 unrelated pairs of speckle, grains, noise and 15 of AFM and STM frames
SIGNIFICANT_EDGES = 30.0  # likewise for edges: unrelated pairs reach 25, because each strong edge occurs once
CONFIRMING_PEAK = 5.0  # standard deviations of the cross-correlation at the peak of the phase correlation
SHADING = 16.0  # longest edge of the frame in standard deviations of the filter that removes shading
MIN_OVERLAP = 0.2  # fraction of the frame that two shifted frames share
TINY = np.float32(1e-20)
TAPER = 0.125  # fraction of an edge over which the window falls to zero
SMOOTHING_PX = (1.0, 6.0)  # standard deviations of the band pass for edges
MAX_SCALE = 2.5  # largest ratio of two magnifications that is tested
LOG_SAMPLES = 512  # samples of the logarithm of the frequency, a hundredth of magnification each
POLAR_PX = 360  # samples of the half circle of the spectrum

ORIENTATIONS: dict[str, tuple[int | None, int | None]] = {  # cv2.rotate code, then cv2.flip code
    "same": (None, None),
    "mirrored_x": (None, 1),
    "mirrored_y": (None, 0),
    "turned_180": (cv2.ROTATE_180, None),
    "turned_90": (cv2.ROTATE_90_COUNTERCLOCKWISE, None),
    "turned_270": (cv2.ROTATE_90_CLOCKWISE, None),
    "transposed": (cv2.ROTATE_90_COUNTERCLOCKWISE, 0),
    "transposed_180": (cv2.ROTATE_90_CLOCKWISE, 0),
}


@dataclass(frozen=True, slots=True)
class Resemblance:
    """Best agreement of two frames.

    Attributes:
        orientation: key of ORIENTATIONS, the change of the reference that gives the current frame.
        negative: whether bright and dark are exchanged.
        edges_only: whether only the edges agree, not the grey levels.
        turn_deg: rotation of the content of the current frame against the reference, clockwise as displayed, beyond `orientation`.
        scale: ratio of the size of details in the current frame to the size in the reference.
        shift_px: motion (x, y) of the content beyond the other changes, px of the frames.
        common_fraction: fraction of the frame that both show after the motion.
        peak: height of the peak of the phase correlation in standard deviations of the surface.
    """

    orientation: str = "same"
    negative: bool = False
    edges_only: bool = False
    turn_deg: float = 0.0
    scale: float = 1.0
    shift_px: tuple[float, float] = (0.0, 0.0)
    common_fraction: float = 1.0
    peak: float = 0.0

    @property
    def significant(self) -> bool:
        """Whether unrelated frames do not agree as well."""
        return self.peak >= (SIGNIFICANT_EDGES if self.edges_only else SIGNIFICANT_PEAK)


def compare_frames(reference: Image, current: Image) -> Resemblance:
    """Return the best agreement of two frames of equal size, (height, width) uint8 or uint16.

    The unchanged frame is tested first, then mirror images and quarter turns, each with both signs of contrast, then rotation with
    magnification, then the edges alone. The first test with a significant peak ends the search.
    """
    best = Resemblance()
    for first, second, binning in _views(reference, current):
        for test in (_by_orientation, _by_similarity, _by_edges):
            found = test(first, second)
            (x, y), (height, width) = found.shift_px, first.shape
            common = max(0.0, 1.0 - abs(x) / width) * max(0.0, 1.0 - abs(y) / height)
            found = replace(found, shift_px=(x * binning, y * binning), common_fraction=common)
            if found.significant:
                return found
            best = max(best, found, key=lambda each: each.peak)
    return best


def _views(reference: Image, current: Image) -> list[tuple[Grey, Grey, int]]:
    """Binned complete frames, and of large frames the central part with less binning."""
    height, width = reference.shape
    binning = max(1, -(-max(height, width) // COARSE_PX))
    views = [(_binned(reference, binning), _binned(current, binning), binning)]
    if max(height, width) > DETAIL_PX:
        top, left = max(0, (height - DETAIL_PX) // 2), max(0, (width - DETAIL_PX) // 2)
        part = np.s_[top : top + DETAIL_PX, left : left + DETAIL_PX]
        finer = DETAIL_PX // COARSE_PX
        views.append((_binned(reference[part], finer), _binned(current[part], finer), finer))
    return views


def _binned(image: Image, binning: int) -> Grey:
    height, width = (n // binning * binning for n in image.shape)
    size = (width // binning, height // binning)
    binned = np.asarray(cv2.resize(image[:height, :width], size, interpolation=cv2.INTER_AREA)).astype(np.float32)
    # shading over the frame agrees with any other shading
    return binned - cv2.GaussianBlur(binned, (0, 0), max(binned.shape) / SHADING)


def _taper(length: int) -> NDArray[np.float32]:
    """Window that is 1 in the middle and falls to zero over TAPER of the length at both ends."""
    edge = max(1, round(TAPER * length))
    window = np.ones(length, dtype=np.float32)
    ramp = (0.5 - 0.5 * np.cos(np.pi * (np.arange(edge) + 0.5) / edge)).astype(np.float32)
    window[:edge] = ramp
    window[-edge:] = ramp[::-1]
    return window


@dataclass(frozen=True, slots=True, eq=False)
class _Surfaces:
    """Correlation of two images at every cyclic shift, in standard deviations of each surface.

    Attributes:
        phase: low-passed phase correlation, whose peak is sharp.
        plain: cross-correlation, whose standard deviation contains the number of independent details of the images.
    """

    phase: NDArray[np.float32]
    plain: NDArray[np.float32]

    def peak(self, sign: float = 1.0) -> tuple[float, tuple[float, float]]:
        """Height of the peak of the phase correlation, zero if the cross-correlation does not confirm it, and its shift (x, y)."""
        height, width = self.phase.shape
        y, x = divmod(int(np.argmax(self.phase if sign > 0.0 else -self.phase)), width)
        near = np.ix_(np.arange(y - 1, y + 2) % height, np.arange(x - 1, x + 2) % width)
        confirmed = float((sign * self.plain[near]).max()) >= CONFIRMING_PEAK
        shift = (float(x - width * (x > width // 2)), float(y - height * (y > height // 2)))
        return (sign * float(self.phase[y, x]) if confirmed else 0.0), shift


def _surfaces(first: Grey, second: Grey, *, padded: bool = False) -> _Surfaces:
    """Correlation of two images of equal shape; `padded` for shifts beyond half a frame."""
    height, width = first.shape
    rows, columns = (int(fft.next_fast_len(n * (2 if padded else 1), real=True) or n) for n in (height, width))
    window = _taper(height)[:, None] * _taper(width)
    a = np.asarray(fft.rfft2(first * window, s=(rows, columns)))
    b = np.asarray(fft.rfft2(second * window, s=(rows, columns)))
    cross = b * np.conj(a)
    passed = low_pass(rows, LOW_PASS)[:, None] * low_pass(columns, LOW_PASS, half=True)
    normalised = [np.asarray(fft.irfft2(c, s=(rows, columns)), dtype=np.float32) for c in (cross * passed / (np.abs(cross) + TINY), cross)]
    if padded:
        overlap = _overlap(rows, height)[:, None] * _overlap(columns, width)
        normalised = [surface * (overlap >= MIN_OVERLAP) for surface in normalised]
    return _Surfaces(*(surface / max(float(surface.std()), 1e-20) for surface in normalised))


def _overlap(length: int, edge: int) -> NDArray[np.float64]:
    """Fraction of an edge that two images share at each cyclic shift of a padded transform."""
    shift = np.minimum(np.arange(length), length - np.arange(length))
    return np.maximum(1.0 - shift / edge, 0.0)


def _oriented(image: Grey, orientation: str) -> Grey:
    turn, flip = ORIENTATIONS[orientation]
    out = image if turn is None else cv2.rotate(image, turn)
    return np.ascontiguousarray(out if flip is None else cv2.flip(out, flip), dtype=np.float32)


def _by_orientation(first: Grey, second: Grey) -> Resemblance:
    """Best of mirror images and quarter turns, of both signs of contrast."""
    best = Resemblance()
    edge = min(first.shape)
    top, left = ((n - edge) // 2 for n in first.shape)
    square = np.s_[top : top + edge, left : left + edge]
    for orientation, (turn, _) in ORIENTATIONS.items():
        crosswise = turn in (cv2.ROTATE_90_CLOCKWISE, cv2.ROTATE_90_COUNTERCLOCKWISE)
        a, b = (first[square], second[square]) if crosswise else (first, second)
        surfaces = _surfaces(_oriented(a, orientation), b, padded=orientation == "same")
        for negative in (False, True):
            peak, shift = surfaces.peak(-1.0 if negative else 1.0)
            if peak > best.peak:
                best = Resemblance(orientation, negative, shift_px=shift, peak=peak)
    return best


def _by_similarity(first: Grey, second: Grey) -> Resemblance:
    """Rotation and magnification from the spectra in log-polar coordinates (Reddy, Chatterji 1996, doi:10.1109/83.506761)."""
    edge = min(min(first.shape), min(second.shape))
    a, b = (_central(image, edge) for image in (first, second))
    radius = edge / 2.0
    polar = [_log_polar_spectrum(image) for image in (a, b)]
    log_step = np.log(radius) / LOG_SAMPLES
    surface = _surfaces(*polar).phase
    best = Resemblance()
    for _ in range(3):
        y, x = divmod(int(np.argmax(surface)), surface.shape[1])
        rows, columns = (np.arange(k - 3, k + 4) % n for k, n in zip((y, x), surface.shape, strict=True))
        scale, turn_deg = float(np.exp(-(x - surface.shape[1] * (x > surface.shape[1] // 2)) * log_step)), y * 180.0 / POLAR_PX
        surface[np.ix_(rows, columns)] = -np.inf
        if not 1.0 / MAX_SCALE <= scale <= MAX_SCALE:
            continue
        for half_turn in (0.0, 180.0):
            angle = (turn_deg + half_turn + 180.0) % 360.0 - 180.0
            # cv2 counts angles counterclockwise as displayed
            matrix = cv2.getRotationMatrix2D((edge / 2.0 - 0.5, edge / 2.0 - 0.5), -angle, scale)
            turned = np.asarray(cv2.warpAffine(a, matrix, (edge, edge), flags=cv2.INTER_LINEAR), dtype=np.float32)
            peak, shift = _surfaces(turned, b).peak()
            if peak > best.peak:
                best = Resemblance(turn_deg=angle, scale=scale, shift_px=shift, peak=peak)
    return best


def _central(image: Grey, edge: int) -> Grey:
    top, left = ((n - edge) // 2 for n in image.shape)
    return np.ascontiguousarray(image[top : top + edge, left : left + edge])


def _log_polar_spectrum(image: Grey) -> Grey:
    """Magnitude of the spectrum of a square image over half a circle (rows) and the logarithm of the frequency (columns)."""
    edge = image.shape[0]
    window = np.hanning(edge).astype(np.float32)
    spectrum = np.asarray(np.abs(fft.fftshift(fft.fft2(image * window * window[:, None]))), dtype=np.float32)
    spectrum = np.log(spectrum / max(float(spectrum.mean()), 1e-20) + np.float32(1e-3))
    spectrum = spectrum - cv2.GaussianBlur(spectrum, (0, 0), edge / 16.0)  # the mean fall towards high frequencies is no detail
    polar = cv2.warpPolar(
        spectrum, (LOG_SAMPLES, 2 * POLAR_PX), (edge / 2.0, edge / 2.0), edge / 2.0, cv2.WARP_POLAR_LOG | cv2.INTER_LINEAR
    )
    half = np.asarray(polar[:POLAR_PX, LOG_SAMPLES // 3 :], dtype=np.float32)  # low frequencies have few independent values
    return half - half.mean()


def _by_edges(first: Grey, second: Grey) -> Resemblance:
    """Agreement of the edges of the unchanged frames: another detector or voltage changes grey levels, and edges remain."""
    peak, shift = _surfaces(edge_strength(first), edge_strength(second), padded=True).peak()
    return Resemblance(edges_only=True, shift_px=shift, peak=peak)


def edge_strength(image: Grey) -> Grey:
    """Length of the gradient of the band-passed image without its mean, (height, width)."""
    fine, coarse = (cv2.GaussianBlur(image, (0, 0), width) for width in SMOOTHING_PX)
    band = fine - coarse
    length = np.hypot(cv2.Sobel(band, cv2.CV_32F, 1, 0), cv2.Sobel(band, cv2.CV_32F, 0, 1))
    return np.asarray(length - length.mean(), dtype=np.float32)
