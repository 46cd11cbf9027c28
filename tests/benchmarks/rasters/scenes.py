"""Hard rasters with known truth: every texture with every disturbance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .detector import MEAN_GREY, Charging, Detector, Noise, RowBrightness, random_brightness
from .motion import Displacement, RowMotion, beam, pixels, random_displacement, random_rows, true_displacement
from .textures import HEIGHT_PX, TEXTURES, WIDTH_PX, Field, Surface, surface


@dataclass(frozen=True, slots=True, eq=False)
class FrameOptics:
    """How one frame of a pair was taken.

    Attributes:
        rows: shifts of the rows.
        detector: contrast transfer.
        charging: tails and brightening.
        brightness: offset, tilt and gain of the rows.
        noise: noise and bits.
    """

    rows: RowMotion
    detector: Detector
    charging: Charging
    brightness: RowBrightness
    noise: Noise


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What makes a pair hard; amplitudes of 0 are left out. Grey levels are those of 8 bits.

    Attributes:
        contrast: factor of the texture's contrast.
        jitter_px: standard deviation of the shift of single rows along x.
        steps: number of lasting steps of each frame.
        single_jumps: number of single rows of each frame that jump.
        offset_grey: standard deviation of the offset of a row.
        gain_sd: standard deviation of the gain of a row.
        tilt_grey: standard deviation of the tilt of a row.
        lost_rows: number of rows of each frame without a measurement.
        first: charging of the first frame.
        second: charging of the second frame.
        detectors: change of the detectors (first, second) of a texture.
        noise: noise of both frames.
        drift_px: largest drift over half the rows.
    """

    contrast: float = 1.0
    jitter_px: float = 0.0
    steps: int = 0
    single_jumps: int = 0
    offset_grey: float = 0.0
    gain_sd: float = 0.0
    tilt_grey: float = 0.0
    lost_rows: int = 0
    first: Charging = field(default_factory=Charging)
    second: Charging = field(default_factory=Charging)
    detectors: Callable[[Detector], tuple[Detector, Detector]] = lambda detector: (detector, detector)
    noise: Noise = field(default_factory=Noise)
    drift_px: float = 3.0


def _changed(detector: Detector) -> tuple[Detector, Detector]:
    """Shadows from two directions 100 degrees apart, other contrast and gamma, negative in an eighth of the surface."""
    grey = detector.contrast_grey
    first = replace(detector, shadow_grey=0.6 * grey, shadow_rad=0.4)
    second = replace(
        detector,
        contrast_grey=0.7 * grey,
        shadow_grey=0.6 * grey,
        shadow_rad=2.15,
        gamma=0.65,
        negative_fraction=0.125,
        brightness_grey=15.0,
    )
    return first, second


def _bright(detector: Detector) -> tuple[Detector, Detector]:
    """Contrast and brightness that clip what lies 1.9 standard deviations above the mean in the first frame, below it in the second."""
    first, second = 2.0 * detector.contrast_grey, 1.6 * detector.contrast_grey
    return (
        replace(detector, contrast_grey=first, brightness_grey=255.0 - MEAN_GREY - 1.9 * first),
        replace(detector, contrast_grey=second, brightness_grey=1.9 * second - MEAN_GREY),
    )


DISTURBANCES: dict[str, Disturbance] = {
    "none": Disturbance(),
    "rows shifted 0.2 px": Disturbance(jitter_px=0.2),
    "rows shifted 0.7 px": Disturbance(jitter_px=0.7),
    "rows shifted 2 px": Disturbance(jitter_px=2.0),
    "row jumps": Disturbance(steps=1, single_jumps=5),
    "row brightness": Disturbance(offset_grey=12.0, gain_sd=0.15, tilt_grey=6.0),
    "weak contrast": Disturbance(contrast=0.35),
    "charging": Disturbance(first=Charging(-0.6, rise_grey=10.0), second=Charging(0.9, rise_grey=30.0)),
    "other detector": Disturbance(detectors=_changed),
    "shot noise": Disturbance(noise=Noise(1.0, shot_grey=0.5)),
    "clipping": Disturbance(detectors=_bright),
    "probe microscope": Disturbance(
        jitter_px=0.4, offset_grey=15.0, gain_sd=0.05, tilt_grey=10.0, lost_rows=4, single_jumps=2, drift_px=5.0, noise=Noise(1.0, bits=16)
    ),
    "electron microscope": Disturbance(
        jitter_px=0.3, steps=1, offset_grey=6.0, gain_sd=0.08, first=Charging(-0.5), second=Charging(-1.0, rise_grey=20.0),
        detectors=lambda detector: (detector, replace(detector, gamma=0.75, contrast_grey=1.2 * detector.contrast_grey)),
        noise=Noise(2.0, shot_grey=0.1),
    ),
}  # fmt: skip

CONTRASTS_GREY = {"speckle": 30.0, "grains": 14.0, "polished": 12.0, "etched": 16.0, "heights": 35.0, "deflection": 16.0}
NAMES = tuple((texture, disturbance) for texture in TEXTURES for disturbance in DISTURBANCES)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One pair and its truth.

    Attributes:
        texture: name of the texture.
        disturbance: name of the disturbance.
        first: (height, width) reference frame.
        second: current frame.
        u: (height, width) true displacement along x of every pixel of the first frame, single-row shifts excluded, px.
        v: likewise along y.
        smooth_u: the same without steps.
        smooth_v: likewise along y.
        clean_first: noise-free grey levels of the first frame at its pixels, without shifts of single rows and without row brightness.
        clean_second: the same of the second frame at its pixels.
        optics: how the two frames were taken.
    """

    texture: str
    disturbance: str
    first: NDArray[np.uint8] | NDArray[np.uint16]
    second: NDArray[np.uint8] | NDArray[np.uint16]
    u: Field
    v: Field
    smooth_u: Field
    smooth_v: Field
    clean_first: Field
    clean_second: Field
    optics: tuple[FrameOptics, FrameOptics]


def _grey(base: Surface, optics: FrameOptics, motion: Displacement | None, *, jitter: bool) -> Field:
    x, y = beam(optics.rows, jitter=jitter)
    if motion is not None:
        x, y = motion.inverse(x, y)
    grey = optics.detector.grey(base, x, y)
    return grey + optics.charging.added(grey)


def render(texture: str, disturbance: Disturbance, name: str, seed: int) -> Scene:
    """Render a pair, a function of its arguments alone."""
    rng = np.random.default_rng([seed, list(TEXTURES).index(texture), *name.encode()])
    base = surface(texture, seed)
    d = disturbance
    motion = random_displacement(rng, drift_px=d.drift_px)
    detectors = d.detectors(Detector(d.contrast * CONTRASTS_GREY[texture]))
    taken = []
    for detector, charging in zip(detectors, (d.first, d.second), strict=True):
        rows = random_rows(rng, d.jitter_px, d.steps, single_jumps=d.single_jumps)
        taken.append(
            FrameOptics(rows, detector, charging, random_brightness(rng, d.offset_grey, d.gain_sd, d.tilt_grey, d.lost_rows), d.noise)
        )
    first, second = taken
    images = [
        optics.noise.expose(optics.brightness.apply(_grey(base, optics, moved, jitter=True), rng), rng)
        for optics, moved in ((first, None), (second, motion))
    ]
    return Scene(
        texture, name, images[0], images[1],
        *true_displacement(motion, first.rows, second.rows), *motion.at(*pixels()),
        _grey(base, first, None, jitter=False), _grey(base, second, motion, jitter=False), (first, second),
    )  # fmt: skip


def scene(number: int) -> Scene:
    """Scene of this number: every texture with every disturbance, then again with other seeds."""
    texture, name = NAMES[number % len(NAMES)]
    return render(texture, DISTURBANCES[name], name, number // len(NAMES))


SIZE = (HEIGHT_PX, WIDTH_PX)
