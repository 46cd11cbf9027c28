"""Natural surfaces without applied speckle, as fields on a grid three times finer than the pixels.

Every surface has two fields: `signal`, the contrast that every detector shows, and `relief`, an independent roughness whose slope a
detector shows as shadows. Both are blurred by the probe (standard deviation PROBE_PX), so cubic spline interpolation between the nodes of
the fine grid is exact to 1e-3 of the contrast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

Field = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX, MARGIN_PX = 320, 288, 48
NODES_PER_PX = 3
PROBE_PX = 0.8
SHAPE = (NODES_PER_PX * (HEIGHT_PX + 2 * MARGIN_PX), NODES_PER_PX * (WIDTH_PX + 2 * MARGIN_PX))


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A surface that can be evaluated at any position.

    Attributes:
        signal: cubic spline coefficients of the contrast, mean 0, standard deviation 1.
        relief: cubic spline coefficients of the roughness, mean 0, standard deviation 1.
    """

    signal: Field
    relief: Field

    def signal_at(self, x_px: Field, y_px: Field) -> Field:
        """Contrast at material positions (any shape), in px of the undeformed frame."""
        return _sample(self.signal, x_px, y_px)

    def slope_at(self, x_px: Field, y_px: Field, direction_rad: float) -> Field:
        """Slope of the roughness along a direction, per px."""
        dx, dy = 0.5 * np.cos(direction_rad), 0.5 * np.sin(direction_rad)
        return _sample(self.relief, x_px + dx, y_px + dy) - _sample(self.relief, x_px - dx, y_px - dy)


def _sample(coefficients: Field, x_px: Field, y_px: Field) -> Field:
    nodes = [NODES_PER_PX * (y_px + MARGIN_PX), NODES_PER_PX * (x_px + MARGIN_PX)]
    return np.asarray(ndimage.map_coordinates(coefficients, nodes, order=3, mode="mirror", prefilter=False))


def _smooth_noise(rng: np.random.Generator, size_px: float) -> Field:
    field = ndimage.gaussian_filter(rng.standard_normal(SHAPE), NODES_PER_PX * size_px, mode="wrap")
    return field / field.std()


def _cells(rng: np.random.Generator, edge_px: float) -> tuple[NDArray[np.int64], Field, int]:
    """Voronoi cells: number of the cell of each node, distance to the boundary in px, and number of cells."""
    height, width = (n / NODES_PER_PX for n in SHAPE)
    count = int(height * width / edge_px**2)
    seeds = rng.uniform(0.0, 1.0, (count, 2)) * (height, width)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / NODES_PER_PX
    y, x = y + 1.5 * _smooth_noise(rng, 4.0), x + 1.5 * _smooth_noise(rng, 4.0)  # curved boundaries
    distance, nearest = KDTree(seeds).query(np.stack([y.ravel(), x.ravel()], axis=1), k=2)
    return nearest[:, 0].reshape(SHAPE), 0.5 * (distance[:, 1] - distance[:, 0]).reshape(SHAPE), count


def _dots(rng: np.random.Generator, per_px2: float, radius_px: tuple[float, float]) -> Field:
    """Sparse dots of random size and unit strength."""
    field = np.zeros(SHAPE)
    for _ in range(int(per_px2 * field.size / NODES_PER_PX**2)):
        radius = NODES_PER_PX * rng.uniform(*radius_px)
        centre = rng.uniform(0.0, 1.0, 2) * SHAPE
        top, left = (max(int(c - 3 * radius), 0) for c in centre)
        part = field[top : int(centre[0] + 3 * radius) + 1, left : int(centre[1] + 3 * radius) + 1]
        y, x = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
        part += np.exp(-((x - centre[1]) ** 2 + (y - centre[0]) ** 2) / (2.0 * (0.5 * radius) ** 2))
    return field


def speckle(rng: np.random.Generator) -> Field:
    """Applied speckle of 5.4 px full width, the control."""
    return _smooth_noise(rng, 1.6)


def grains(rng: np.random.Generator) -> Field:
    """Polycrystal in backscattered electrons: grains of 14 px with one grey level each, and weak structure within them."""
    cell, _, count = _cells(rng, 14.0)
    return rng.standard_normal(count)[cell] + 0.15 * _smooth_noise(rng, 2.5)


def polished(rng: np.random.Generator) -> Field:
    """Polished metal: fine scratches in all directions, few inclusions, weak stains."""
    field = np.zeros(SHAPE)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / NODES_PER_PX
    for _ in range(140):
        angle = rng.uniform(0.0, np.pi)
        normal = (np.cos(angle), np.sin(angle))
        distance = normal[0] * (x - rng.uniform(0, x.max())) + normal[1] * (y - rng.uniform(0, y.max()))
        near = np.abs(distance) < 4.0
        along = normal[0] * y - normal[1] * x
        ends = np.sort(rng.uniform(along.min(), along.max(), 2))
        near &= (along > ends[0]) & (along < ends[1])
        field[near] += rng.normal(0.0, 1.0) * np.exp(-0.5 * (distance[near] / rng.uniform(0.6, 1.2)) ** 2)
    return field - 2.0 * _dots(rng, 2e-3, (1.5, 4.0)) + 0.25 * _smooth_noise(rng, 5.0)


def etched(rng: np.random.Generator) -> Field:
    """Etched metal: dark grain boundaries of grains of 22 px, weak grey levels of the grains, etch pits."""
    cell, boundary, count = _cells(rng, 22.0)
    return 0.5 * rng.standard_normal(count)[cell] - 2.0 * np.exp(-0.5 * (boundary / 1.2) ** 2) - 1.5 * _dots(rng, 4e-3, (1.0, 2.5))


def heights(rng: np.random.Generator) -> Field:
    """Height map of a film of grains: overlapping domes, smooth within a dome, creased between domes."""
    field = np.full(SHAPE, -1.0)
    for _ in range(int(field.size / NODES_PER_PX**2 / 220)):
        radius = NODES_PER_PX * rng.uniform(9.0, 24.0)
        centre = rng.uniform(0.0, 1.0, 2) * SHAPE
        top, left = (max(int(c - radius), 0) for c in centre)
        part = field[top : int(centre[0] + radius) + 1, left : int(centre[1] + radius) + 1]
        y, x = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
        square = ((x - centre[1]) ** 2 + (y - centre[0]) ** 2) / radius**2
        np.maximum(part, rng.uniform(-0.6, 0.6) + np.sqrt(np.clip(1.0 - square, 0.0, None)) - (square > 1.0) * 9.0, out=part)
    return field + 0.02 * _smooth_noise(rng, 1.5)


def deflection(rng: np.random.Generator) -> Field:
    """Deflection channel: slope along the fast axis of a rough height map, and few bright ridges."""
    rough = sum(weight * _smooth_noise(rng, size) for weight, size in ((0.25, 1.5), (1.0, 4.0), (3.0, 12.0)))
    return np.gradient(np.asarray(rough) + 3.0 * _dots(rng, 5e-4, (3.0, 7.0)), axis=1)


TEXTURES: dict[str, Callable[[np.random.Generator], Field]] = {
    each.__name__: each for each in (speckle, grains, polished, etched, heights, deflection)
}


@lru_cache(maxsize=2)
def surface(name: str, seed: int) -> Surface:
    """The surface of this name, a function of its seed alone."""
    rng = np.random.default_rng([seed, list(TEXTURES).index(name)])
    fields = (TEXTURES[name](rng), _smooth_noise(rng, 2.0))
    blurred = [ndimage.gaussian_filter(field, NODES_PER_PX * PROBE_PX) for field in fields]
    return Surface(*(ndimage.spline_filter((field - field.mean()) / field.std(), order=3) for field in blurred))
