"""An elliptic opening in an elastic plate, at points in real numbers, so that the loops are vectorised.

The formulas and their sources are those of `semlive_simulators.specimen.elliptic`.
"""

from __future__ import annotations

import math

from numba import njit

_TINY = 1e-300


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _mapped(x, y, flatness):
    """The zeta of z = zeta + m / zeta that is large far away, for z = x + i y."""
    a = x * x - y * y - 4.0 * flatness
    b = 2.0 * x * y
    p = math.sqrt(0.5 * (math.sqrt(a * a + b * b) + abs(a)))
    q = 0.5 * abs(b) / max(p, _TINY)
    root_x = p if a >= 0.0 else q
    root_y = q if a >= 0.0 else p
    # The root in the direction of z; b has the sign of x y.
    root_x = root_x if x >= 0.0 else -root_x
    root_y = root_y if y >= 0.0 else -root_y
    return 0.5 * (x + root_x), 0.5 * (y + root_y)


@njit(cache=True, nogil=True, error_model="numpy")
def outside(radius, x_px, y_px, size_px, flatness):
    """Write |zeta| of points (n,) from the centre of the opening."""
    for index in range(radius.size):
        zeta_x, zeta_y = _mapped(x_px[index] / size_px, y_px[index] / size_px, flatness)
        radius[index] = math.sqrt(zeta_x * zeta_x + zeta_y * zeta_y)


@njit(cache=True, nogil=True, error_model="numpy")
def opened(u_px, v_px, x_px, y_px, size_px, flatness, poissons_ratio):
    """Additional displacement by the opening at a remote strain of 1; inside the value on its edge.

    Args:
        u_px: (n,) float64, written.
        v_px: likewise.
        x_px: (n,) float64 material points from the centre of the opening.
        y_px: likewise.
        size_px: R, half the sum of the half axes.
        flatness: m, their difference over their sum.
        poissons_ratio: nu.
    """
    m = flatness
    kappa = (3.0 - poissons_ratio) / (1.0 + poissons_ratio)
    scale = 0.5 * size_px * (1.0 + poissons_ratio)
    for index in range(u_px.size):
        zeta_x, zeta_y = _mapped(x_px[index] / size_px, y_px[index] / size_px, m)
        radius = math.sqrt(zeta_x * zeta_x + zeta_y * zeta_y)
        inwards = 1.0 / max(radius, 1e-9) if radius < 1.0 else 1.0
        zeta_x = 1.0 if radius < 1e-9 else zeta_x * inwards
        zeta_y = 0.0 if radius < 1e-9 else zeta_y * inwards
        square = zeta_x * zeta_x + zeta_y * zeta_y
        # i = 1 / zeta, s = i^2, d = 1 / (1 - m s)
        ix, iy = zeta_x / square, -zeta_y / square
        sx, sy = ix * ix - iy * iy, 2.0 * ix * iy
        nx, ny = 1.0 - m * sx, -m * sy
        norm = nx * nx + ny * ny
        dx, dy = nx / norm, -ny / norm
        # (phi' / w' - 1 / 4) / (R / 2) = (1 + m) s d / R
        gx, gy = (1.0 + m) * (sx * dx - sy * dy), (1.0 + m) * (sx * dy + sy * dx)
        zx, zy = zeta_x + m * ix, zeta_y + m * iy
        bent_x, bent_y = zx * gx + zy * gy, zy * gx - zx * gy
        # psi without the plate's, over -R / 2: i ((1 + m + m^2 + s) d + m)
        kx, ky = 1.0 + m + m * m + sx, sy
        hx, hy = kx * dx - ky * dy + m, kx * dy + ky * dx
        psi_x, psi_y = ix * hx - iy * hy, ix * hy + iy * hx
        u_px[index] = scale * (psi_x - kappa * (1.0 + m) * ix - bent_x)
        v_px[index] = scale * (-psi_y - kappa * (1.0 + m) * iy - bent_y)


@njit(cache=True, nogil=True, error_model="numpy")
def darken(grey, x_px, y_px, size_px, flatness, level, edge_px):
    """Mix grey levels (n,) with the level of the opening, in place; its edge is a quintic step of half width about `edge_px`."""
    for index in range(grey.size):
        zeta_x, zeta_y = _mapped(x_px[index] / size_px, y_px[index] / size_px, flatness)
        t = 0.5 + (math.sqrt(zeta_x * zeta_x + zeta_y * zeta_y) - 1.0) * size_px / (2.0 * edge_px)
        t = min(1.0, max(0.0, t))
        grey[index] = level + (grey[index] - level) * t * t * t * (10.0 + t * (6.0 * t - 15.0))
