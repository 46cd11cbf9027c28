"""Inverse-compositional Gauss-Newton for an affine subset under ZNSSD.

Baker, Matthews 2004, doi:10.1023/B:VISI.0000011205.11775.fd; Pan, Li, Tong 2013, doi:10.1007/s11340-012-9695-2.

One pass over the subset per iteration: with the reference's sums known, ZNSSD and its gradient need seven sums of the
interpolated image only. A row of the subset is cut where it crosses a pixel boundary of the current image, so that inside a
piece the taps are contiguous; pieces are padded to LANES with a 0/1 mask (43 -> 48 px), which spares the scalar rest of
vectorised loops (a third of the time).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy import uint64

LANES = 8
EIGHT, ONE, TWO, THREE = uint64(LANES), uint64(1), uint64(2), uint64(3)
BORDER = 2  # mirrored coefficients around the frame


def border_of(order: int) -> int:
    """Mirrored coefficients around the frame that a spline of this order needs."""
    return order // 2 + 1


CONVERGED, NOT_CONVERGED, LOW_ZNCC, OUTSIDE_IMAGE = 0, 1, 2, 3  # as in semlive.data.disparity.PoiStatus
EDGE_SLACK_PX = 0.05  # into the mirrored border: costs 1e-3 px at most, keeps edge subsets that did not move
MAX_GRADIENT = 0.5  # a subset that turns inside out has lost its way
SKIP, SEEDED, CHAINED = 0, 1, 2


# fastmath: all operands are finite by construction, and sums in any order are what makes the loop vectorise.
@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _piece(c, a0, a1, a2, a3, f, gx, gy, at, mask, at_mask, ramp, count, tx, ux, ty, vx):
    """Seven masked sums over one piece of a row; g is the interpolated current image.

    `a0` ... `a3` are the positions in `c` of the first tap on each of four rows, `at` that of the first pixel in `f`, `gx`
    and `gy`, `at_mask` in `mask`. `count` is a multiple of LANES; the loop's bound says so to the compiler.
    """
    one, three, four, six = np.float32(1.0), np.float32(3.0), np.float32(4.0), np.float32(6.0)
    scale = np.float32(1.0 / 36.0)
    s_g = s_gg = s_gf = s_x = s_xr = s_y = s_yr = np.float32(0.0)
    for i in range(count // EIGHT * EIGHT):
        r = ramp[i]
        t = tx + r * ux
        t2 = t * t
        o = one - t
        x0 = o * o * o
        x1 = four + t2 * (three * t - six)
        x3 = t2 * t
        x2 = six - x0 - x1 - x3
        t = ty + r * vx
        t2 = t * t
        o = one - t
        y0 = o * o * o
        y1 = four + t2 * (three * t - six)
        y3 = t2 * t
        y2 = six - y0 - y1 - y3
        g = (
            y0 * (x0 * c[a0 + i] + x1 * c[a0 + i + ONE] + x2 * c[a0 + i + TWO] + x3 * c[a0 + i + THREE])
            + y1 * (x0 * c[a1 + i] + x1 * c[a1 + i + ONE] + x2 * c[a1 + i + TWO] + x3 * c[a1 + i + THREE])
            + y2 * (x0 * c[a2 + i] + x1 * c[a2 + i + ONE] + x2 * c[a2 + i + TWO] + x3 * c[a2 + i + THREE])
            + y3 * (x0 * c[a3 + i] + x1 * c[a3 + i + ONE] + x2 * c[a3 + i + TWO] + x3 * c[a3 + i + THREE])
        ) * (scale * mask[at_mask + i])
        s_g += g
        s_gg += g * g
        s_gf += g * f[at + i]
        wx = g * gx[at + i]
        s_x += wx
        s_xr += wx * r
        wy = g * gy[at + i]
        s_y += wy
        s_yr += wy * r
    return s_g, s_gg, s_gf, s_x, s_xr, s_y, s_yr


@njit(nogil=True, cache=True, error_model="numpy")
def _steps_inside(position, slope, limit):
    """How many steps of `slope` stay in the same unit cell, counting the first; at most `limit`."""
    if slope > 0.0:
        room = np.ceil((np.floor(position) + 1.0 - position) / slope)
    elif slope < 0.0:
        room = np.floor((np.floor(position) - position) / slope) + 1.0
    else:
        return limit
    return limit if room >= limit else max(int(room), 1)


@njit(nogil=True, cache=True, error_model="numpy")
def _subset_sums(c, stride_c, f, gx, gy, stride, mask, ramp, xc, yc, half, p, sums, projection):
    """Sums over the deformed subset: `sums` = (g, gg, gf), `projection` = g times the six derivatives."""
    size = 2 * half + 1
    full = mask.size - LANES
    sums[:] = 0.0
    projection[:] = 0.0
    ux, vx = p[1], p[4]
    slope_x, slope_y = np.float32(ux), np.float32(vx)
    for row in range(size):
        dy = row - half
        y = yc + dy
        left_x = xc - half + p[0] - half * ux + dy * p[2]  # column minus index in the row
        left_y = y + p[3] - half * vx + dy * p[5]
        start = 0
        while start < size:
            at_x = left_x + start * ux
            at_y = left_y + start * vx
            count = _steps_inside(at_x, ux, size - start)
            count = _steps_inside(at_y, vx, count)
            padded = (count + LANES - 1) // LANES * LANES
            ix = int(np.floor(at_x))
            iy = int(np.floor(at_y))
            tap = (iy + BORDER - 1) * stride_c + ix + start + BORDER - 1
            pixel = y * stride + xc - half + start
            s_g, s_gg, s_gf, s_x, s_xr, s_y, s_yr = _piece(
                c, uint64(tap), uint64(tap + stride_c), uint64(tap + 2 * stride_c), uint64(tap + 3 * stride_c),
                f, gx, gy, uint64(pixel), mask, uint64(full - count), ramp, uint64(padded),
                np.float32(at_x - ix), slope_x, np.float32(at_y - iy), slope_y,
            )  # fmt: skip
            sums[0] += s_g
            sums[1] += s_gg
            sums[2] += s_gf
            dx = start - half
            projection[0] += s_x
            projection[1] += s_xr + dx * s_x
            projection[2] += dy * s_x
            projection[3] += s_y
            projection[4] += s_yr + dx * s_y
            projection[5] += dy * s_y
            start += count


@njit(nogil=True, cache=True, error_model="numpy")
def _solve(lower, b):
    """Solve L L^T x = b in place."""
    n = b.size
    for i in range(n):
        value = b[i]
        for k in range(i):
            value -= lower[i, k] * b[k]
        b[i] = value / lower[i, i]
    for i in range(n - 1, -1, -1):
        value = b[i]
        for k in range(i + 1, n):
            value -= lower[k, i] * b[k]
        b[i] = value / lower[i, i]


@njit(nogil=True, cache=True, error_model="numpy")
def _compose_inverse(p, d):
    """Warp p followed after the inverse of warp d, in place in p: W(p) <- W(p) o W(d)^-1."""
    a, b, c, e = 1.0 + d[1], d[2], d[4], 1.0 + d[5]
    det = a * e - b * c
    ia, ib, ic, ie = e / det, -b / det, -c / det, a / det
    tx = -(ia * d[0] + ib * d[3])
    ty = -(ic * d[0] + ie * d[3])
    for k in range(0, 6, 3):
        along_x = p[k + 1] + (1.0 if k == 0 else 0.0)
        along_y = p[k + 2] + (0.0 if k == 0 else 1.0)
        p[k] += along_x * tx + along_y * ty
        p[k + 1] = along_x * ia + along_y * ic - (1.0 if k == 0 else 0.0)
        p[k + 2] = along_x * ib + along_y * ie - (0.0 if k == 0 else 1.0)


@njit(nogil=True, cache=True, error_model="numpy")
def _inside(xc, yc, half, p, width, height):
    """Whether the deformed subset lies within the frame, but for what noise and rounding move."""
    reach_x = half * (abs(1.0 + p[1]) + abs(p[2]))
    reach_y = half * (abs(p[4]) + abs(1.0 + p[5]))
    x = xc + p[0]
    y = yc + p[3]
    inside_x = x - reach_x >= -EDGE_SLACK_PX and x + reach_x <= width - 1.0 + EDGE_SLACK_PX
    inside_y = y - reach_y >= -EDGE_SLACK_PX and y + reach_y <= height - 1.0 + EDGE_SLACK_PX
    return inside_x and inside_y


@njit(nogil=True, cache=True, error_model="numpy")
def correlate_row(
    c, stride_c, f, gx, gy, stride, mask, ramp, width, y, x0, step, half, mean, norm, gradient_sum, gradient_image_sum, lower,
    todo, seed, max_iterations, tolerance_px, min_zncc, max_travel_px, p, zncc, status, iterations,
):  # fmt: skip
    """Correlate one row of POI, from left to right.

    `c`, `f`, `gx`, `gy` are images laid out as one line, `stride_c` and `stride` floats a row: a view of a row would cost
    more (two counted references) than the arithmetic on it (5.5 against 1.6 ns per pixel and iteration).

    A POI marked CHAINED starts from its left neighbour's solution if that converged in this call, else, like one marked
    SEEDED, from `seed`; one marked SKIP is left alone. A POI that moves more than `max_travel_px` from its start is given up.
    """
    height = c.size // stride_c - 2 * BORDER
    pixels = float((2 * half + 1) ** 2)
    sums = np.empty(3)
    update = np.empty(6)
    q = np.empty(6)
    left_converged = False
    for i in range(todo.size):
        if todo[i] == SKIP:
            left_converged = False
            continue
        xc = x0 + i * step
        if todo[i] == CHAINED and left_converged:
            q[:] = p[i - 1]
            q[0] += step * q[1]
            q[3] += step * q[4]
        else:
            q[:] = seed[i]
        start_u = q[0]
        start_v = q[3]
        result = NOT_CONVERGED
        score = 0.0
        count = 0
        while count < max_iterations:
            if not _inside(xc, y, half, q, width, height):
                result = OUTSIDE_IMAGE
                break
            count += 1
            _subset_sums(c, stride_c, f, gx, gy, stride, mask, ramp, xc, y, half, q, sums, update)
            g_mean = sums[0] / pixels
            g_norm = np.sqrt(max(sums[1] - sums[0] * g_mean, 0.0))
            if not g_norm > 1e-6 * norm[i]:
                result = LOW_ZNCC
                break
            score = (sums[2] - sums[0] * mean[i]) / (norm[i] * g_norm)
            ratio = norm[i] / g_norm
            for k in range(6):
                update[k] = ratio * (update[k] - g_mean * gradient_sum[i, k]) - gradient_image_sum[i, k]
            _solve(lower[i], update)
            _compose_inverse(q, update)
            if abs(q[0] - start_u) + abs(q[3] - start_v) > max_travel_px or max(abs(q[1]), abs(q[2]), abs(q[4]), abs(q[5])) > MAX_GRADIENT:
                break
            corner_x = abs(update[0]) + half * (abs(update[1]) + abs(update[2]))
            corner_y = abs(update[3]) + half * (abs(update[4]) + abs(update[5]))
            if corner_x * corner_x + corner_y * corner_y <= tolerance_px * tolerance_px:
                result = CONVERGED if score >= min_zncc else LOW_ZNCC
                break
        left_converged = result == CONVERGED
        p[i] = q
        zncc[i] = score
        status[i] = result
        iterations[i] = count
