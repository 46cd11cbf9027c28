"""Pairs of frames that lead a correlation astray, with what is true of each pixel.

Independent of the engine: a smooth random texture is drawn at positions known exactly, then things are put in front of it. The
interpolation of the texture (cubic, speckle of 6.7 px) is good to 0.02 px, far below the errors that are looked for here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT, MARGIN = 640, 560, 160
CONTRAST = 39.0
SPOT_PX = 2.0  # a blob's standard deviation; the autocorrelation is 6.7 px wide


@dataclass(frozen=True)
class Affine:
    """x_current = centre + a (x - centre) + shift."""

    a: NDArray
    shift: NDArray

    def at(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Displacement (u, v) at reference positions."""
        dx, dy = x - WIDTH / 2, y - HEIGHT / 2
        (a, b), (c, d) = self.a
        return (a - 1) * dx + b * dy + self.shift[0], c * dx + (d - 1) * dy + self.shift[1]

    def back(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Reference positions of current positions."""
        (a, b), (c, d) = np.linalg.inv(self.a)
        dx, dy = x - WIDTH / 2 - self.shift[0], y - HEIGHT / 2 - self.shift[1]
        return WIDTH / 2 + a * dx + b * dy, HEIGHT / 2 + c * dx + d * dy


@dataclass(frozen=True)
class Scene:
    """One pair and its truth.

    Attributes:
        name: of the case.
        noise: grey levels.
        first, second: the frames.
        u, v: (h, w) true displacement of each reference pixel, px.
        plain: (h, w) whether a reference pixel is seen in both frames, of one motion with its surroundings.
        judged: (h, w) whether a motion is defined there at all.
        unique: (h, w) whether the texture there does not repeat itself.
    """

    name: str
    noise: float
    first: NDArray[np.uint8]
    second: NDArray[np.uint8]
    u: NDArray
    v: NDArray
    plain: NDArray[np.bool_]
    judged: NDArray[np.bool_]
    unique: NDArray[np.bool_]


def texture(rng: np.random.Generator, width: int = WIDTH + 2 * MARGIN, height: int = HEIGHT + 2 * MARGIN, spot: float = SPOT_PX) -> NDArray:
    """Smooth random grey levels, mean 0, standard deviation CONTRAST, periodic over its edges."""
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    white = np.fft.rfft2(rng.standard_normal((height, width)))
    smooth = np.fft.irfft2(white * np.exp(-2.0 * (np.pi * spot) ** 2 * (fx**2 + fy**2)), s=(height, width))
    return (CONTRAST * smooth / smooth.std()).astype(np.float32)


def _sample(image: NDArray, x: NDArray, y: NDArray) -> NDArray:
    return cv2.remap(
        image, (x + MARGIN).astype(np.float32), (y + MARGIN).astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def _expose(grey: NDArray, noise: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    return np.clip(np.round(grey + noise * rng.standard_normal(grey.shape)), 0, 255).astype(np.uint8)


def _pixels() -> tuple[NDArray, NDArray]:
    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    return x, y


def random_motion(rng: np.random.Generator, shift: float = 60.0, degrees: float = 8.0, strain: float = 0.03) -> Affine:
    """Shift within a circle, rotation and strain uniform within bounds."""
    angle, radius, way = np.radians(rng.uniform(-degrees, degrees)), shift * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
    exx, eyy, exy = rng.uniform(-strain, strain, 3)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return Affine(turn @ np.array([[1 + exx, exy / 2], [exy / 2, 1 + eyy]]), radius * np.array([np.cos(way), np.sin(way)]))


def blobs(rng: np.random.Generator, fraction: float, smallest: float = 15.0, largest: float = 90.0) -> NDArray[np.bool_]:
    """(h, w) discs and rectangles that cover this fraction of a frame."""
    covered = np.zeros((HEIGHT, WIDTH), np.uint8)
    while covered.mean() < fraction:
        x, y = int(rng.integers(0, WIDTH)), int(rng.integers(0, HEIGHT))
        a, b = (int(n) for n in rng.uniform(smallest, largest, 2))
        if rng.uniform() < 0.5:
            cv2.ellipse(covered, ((float(x), float(y)), (2.0 * a, 2.0 * b), float(rng.uniform(0, 180))), 1, -1)
        else:
            cv2.rectangle(covered, (x - a, y - b), (x + a, y + b), 1, -1)
    return covered.astype(bool)


Paint = Callable[[NDArray, NDArray], NDArray]  # (grey, x, y) of a frame to grey with something in front


def _pair(
    name: str,
    noise: float,
    rng: np.random.Generator,
    motion: Affine,
    base: NDArray,
    *,
    hidden_first: NDArray[np.bool_] | None = None,
    hidden_second: NDArray[np.bool_] | None = None,
    fill_first: NDArray | float = 0.0,
    fill_second: NDArray | float = 0.0,
    unique: NDArray[np.bool_] | None = None,
    gain: float = 1.0,
    offset: float = 0.0,
) -> Scene:
    x, y = _pixels()
    u, v = motion.at(x, y)
    none = np.zeros(x.shape, bool)
    hidden_first = none if hidden_first is None else hidden_first
    hidden_second = none if hidden_second is None else hidden_second
    first = np.where(hidden_first, fill_first, 128.0 + _sample(base, x, y))
    second = np.where(hidden_second, fill_second, offset + 128.0 + gain * _sample(base, *motion.back(x, y)))
    xc, yc = (x + u).astype(np.float32), (y + v).astype(np.float32)
    hidden_there = cv2.remap(hidden_second.astype(np.float32), xc, yc, cv2.INTER_LINEAR, borderValue=1.0) > 0
    return Scene(
        name, noise, _expose(first, noise, rng), _expose(second, noise, rng), u, v, ~hidden_first & ~hidden_there,
        np.ones(x.shape, bool), np.ones(x.shape, bool) if unique is None else unique,
    )  # fmt: skip


def moved(rng: np.random.Generator, noise: float) -> Scene:
    """Nothing but a large motion."""
    return _pair("large motion", noise, rng, random_motion(rng), texture(rng))


def lit(rng: np.random.Generator, noise: float) -> Scene:
    """Contrast and brightness change."""
    return _pair("contrast change", noise, rng, random_motion(rng), texture(rng), gain=rng.uniform(0.55, 1.2), offset=rng.uniform(-30, 30))


def _fill(rng: np.random.Generator) -> NDArray | float:
    """What covers: black, white, the mean grey, or another texture."""
    kind = int(rng.integers(0, 4))
    return (0.0, 128.0, 255.0)[kind] if kind < 3 else 128.0 + texture(rng)[:HEIGHT, :WIDTH]


def occluded(rng: np.random.Generator, noise: float) -> Scene:
    """30 % of the current frame is covered."""
    motion = random_motion(rng, degrees=4.0)
    return _pair("30 % occluded", noise, rng, motion, texture(rng), hidden_second=blobs(rng, 0.3), fill_second=_fill(rng))


def half_missing(rng: np.random.Generator, noise: float) -> Scene:
    """Half of the current frame is covered by few large things."""
    motion = random_motion(rng, degrees=4.0)
    return _pair("50 % missing", noise, rng, motion, texture(rng), hidden_second=blobs(rng, 0.5, 80, 240), fill_second=_fill(rng))


def blank_on_screen(rng: np.random.Generator, noise: float) -> Scene:
    """Areas of one grey level, at the same place in both frames while the specimen moves."""
    blank = blobs(rng, 0.25)
    level = float(rng.choice([0.0, 60.0, 128.0, 255.0]))
    motion = random_motion(rng, shift=30.0, degrees=2.0)
    return _pair(
        "blank on screen", noise, rng, motion, texture(rng), hidden_first=blank, hidden_second=blank, fill_first=level, fill_second=level
    )


def blank_on_specimen(rng: np.random.Generator, noise: float) -> Scene:
    """Areas without speckle that move with the specimen."""
    base = texture(rng)
    blank = np.zeros(base.shape, bool)
    blank[MARGIN : MARGIN + HEIGHT, MARGIN : MARGIN + WIDTH] = blobs(rng, 0.3)
    soft = cv2.GaussianBlur(blank.astype(np.float32), (0, 0), 1.5)
    scene = _pair("blank on specimen", noise, rng, random_motion(rng), base * (1 - soft) + soft * float(rng.uniform(-128, 127)))
    plain = scene.plain & ~(soft[MARGIN : MARGIN + HEIGHT, MARGIN : MARGIN + WIDTH] > 0)
    return Scene(scene.name, noise, scene.first, scene.second, scene.u, scene.v, plain, scene.judged, scene.unique)


def repeating(rng: np.random.Generator, noise: float) -> Scene:
    """A tile repeated over the complete frame, or over a part of it."""
    base = texture(rng)
    periods = rng.integers(17, 110, 2)
    tile = texture(rng, int(periods[0]), int(periods[1]))
    tiled = np.tile(tile, (base.shape[0] // tile.shape[0] + 1, base.shape[1] // tile.shape[1] + 1))[: base.shape[0], : base.shape[1]]
    part = np.ones(base.shape, bool)
    if rng.uniform() < 0.6:
        part[:] = False
        left, top = rng.integers(MARGIN, MARGIN + 200, 2)
        part[top : top + 320, left : left + 350] = True
    unique = ~part[MARGIN : MARGIN + HEIGHT, MARGIN : MARGIN + WIDTH]
    return _pair("repeating", noise, rng, random_motion(rng, degrees=2.0), np.where(part, tiled, base), unique=unique)


def cracked(rng: np.random.Generator, noise: float, spot: float = SPOT_PX, contrast: float = CONTRAST) -> Scene:
    """Two halves that part and slide along a straight line by up to 20 px; spots of a standard deviation in px, contrast in grey levels."""
    x, y = _pixels()
    whole = random_motion(rng, shift=20.0, degrees=2.0, strain=0.01)
    way = rng.uniform(0, 2 * np.pi)
    normal = np.array([np.cos(way), np.sin(way)])
    jump = rng.choice([rng.uniform(0.5, 4.0), rng.uniform(4.0, 20.0)])
    slide = rng.uniform(-1.0, 1.0)
    across = jump * (np.sqrt(1 - slide**2) * normal + slide * np.array([-normal[1], normal[0]]))
    other = Affine(whole.a, whole.shift + across)
    centre = np.array([WIDTH / 2, HEIGHT / 2]) + rng.uniform(-80, 80, 2)

    def beyond(px: NDArray, py: NDArray) -> NDArray:
        return (px - centre[0]) * normal[0] + (py - centre[1]) * normal[1] > 0

    base = texture(rng, spot=spot) * np.float32(contrast / CONTRAST)
    near, far = whole.back(x, y), other.back(x, y)
    of_far = beyond(*far)
    of_near = ~beyond(*near) & ~of_far
    grey = np.where(of_far, _sample(base, *far), _sample(base, *near))
    second = np.where(of_far | of_near, 128.0 + grey, float(rng.choice([0.0, 128.0])))
    side = beyond(x, y)
    u, v = (np.where(side, b, a) for a, b in zip(whole.at(x, y), other.at(x, y), strict=True))
    distance = np.abs((x - centre[0]) * normal[0] + (y - centre[1]) * normal[1])
    inside = (x + u > 1) & (x + u < WIDTH - 2) & (y + v > 1) & (y + v < HEIGHT - 2)
    first = _expose(128.0 + _sample(base, x, y), noise, rng)
    everywhere = np.ones(x.shape, bool)
    return Scene("crack", noise, first, _expose(second, noise, rng), u, v, inside & (distance > 2.0), distance > 1.0, everywhere)


@dataclass(frozen=True, slots=True)
class Pattern:
    """Standard deviation of the spots in px, contrast and noise in grey levels."""

    spot_px: float
    contrast_grey: float
    noise_grey: float


DIFFICULT_PATTERNS = {
    "coarse": Pattern(4.0, CONTRAST, 5.0),
    "very coarse": Pattern(7.0, CONTRAST, 5.0),
    "weak": Pattern(SPOT_PX, 7.0, 5.0),
    "coarse and weak": Pattern(4.0, 12.0, 5.0),
}


def cracked_scene(number: int) -> Scene:
    """Scene of this number with a crack in a pattern that is difficult for subsets, the patterns in turn."""
    name = list(DIFFICULT_PATTERNS)[number % len(DIFFICULT_PATTERNS)]
    pattern = DIFFICULT_PATTERNS[name]
    s = cracked(np.random.default_rng([1000, number]), pattern.noise_grey, pattern.spot_px, pattern.contrast_grey)
    return replace(s, name=f"crack, {name}")


CASES = (moved, lit, occluded, half_missing, blank_on_screen, blank_on_specimen, repeating, cracked)
NOISES = (2.0, 5.0, 10.0, 20.0)


def scene(number: int) -> Scene:
    """Scene of this number: every case at every noise in turn, each with a seed of its own."""
    case, noise = CASES[number % len(CASES)], NOISES[number // len(CASES) % len(NOISES)]
    return case(np.random.default_rng(1000 + number), noise)
