"""B-spline interpolation along a piece of a line that moves slowly against the pixels, written for the vectoriser.

Within a piece all pixels have the same offsets of taps, so the taps are contiguous in memory. Positions are quadratic in the index, as
a second-order shape function needs; an affine one passes constant curvatures of zero, which take no time. The result is multiplied by
the common denominator of the weights (`SCALE`).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy import uint64

LANES = 8
SCALE = {3: 36.0, 5: 14400.0}
EIGHT, ONE, TWO, THREE, FOUR, FIVE = uint64(LANES), uint64(1), uint64(2), uint64(3), uint64(4), uint64(5)


# fastmath: all operands are finite by construction, and sums in any order are what makes the loops vectorise.
@njit(nogil=True, cache=True, error_model="numpy", fastmath=True, inline="always")
def cubic_piece(c, tap, stride, out, at, ramp, count, tx, ux, uxx, ty, vx, vxx, offset):
    """Write 36 times the interpolated image, less `offset`, to out[at : at + count].

    `tap` is the position in `c` of the first of four taps of the first pixel on the first of four rows, `tx` and `ty` are the
    phases there, `ux`, `uxx`, `vx`, `vxx` their changes by the index and its square. `count` is a multiple of LANES; the bound
    of the loop passes this to the compiler. Indices are unsigned, because checks of signed ones take four times as long.
    """
    one, three, four, six = np.float32(1.0), np.float32(3.0), np.float32(4.0), np.float32(6.0)
    a0 = tap
    a1 = a0 + stride
    a2 = a1 + stride
    a3 = a2 + stride
    for i in range(count // EIGHT * EIGHT):
        r = ramp[i]
        t = tx + r * (ux + r * uxx)
        t2 = t * t
        o = one - t
        o2 = o * o
        x0 = o2 * o
        x1 = four + t2 * (three * t - six)
        x2 = four - o2 * (three * t + three)
        x3 = t2 * t
        t = ty + r * (vx + r * vxx)
        t2 = t * t
        o = one - t
        o2 = o * o
        y0 = o2 * o
        y1 = four + t2 * (three * t - six)
        y2 = four - o2 * (three * t + three)
        y3 = t2 * t
        g = (
            y0 * (x0 * c[a0 + i] + x1 * c[a0 + i + ONE] + x2 * c[a0 + i + TWO] + x3 * c[a0 + i + THREE])
            + y1 * (x0 * c[a1 + i] + x1 * c[a1 + i + ONE] + x2 * c[a1 + i + TWO] + x3 * c[a1 + i + THREE])
            + y2 * (x0 * c[a2 + i] + x1 * c[a2 + i + ONE] + x2 * c[a2 + i + TWO] + x3 * c[a2 + i + THREE])
            + y3 * (x0 * c[a3 + i] + x1 * c[a3 + i + ONE] + x2 * c[a3 + i + TWO] + x3 * c[a3 + i + THREE])
        )
        out[at + i] = g - offset


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True, inline="always")
def quintic_weights(t):
    """The six weights, times 120, at phase t."""
    c5, c10, c20, c26, c30 = np.float32(5.0), np.float32(10.0), np.float32(20.0), np.float32(26.0), np.float32(30.0)
    c50, c60, c66 = np.float32(50.0), np.float32(60.0), np.float32(66.0)
    o = np.float32(1.0) - t
    t2 = t * t
    o2 = o * o
    w0 = o2 * o2 * o
    w1 = c26 + t * (c20 * t - c50) + t2 * t * (c20 + t * (c5 * t - c20))
    w2 = c66 + t2 * (t2 * (c30 - c10 * t) - c60)
    w3 = c26 + t * (c50 + c20 * t) + t2 * t * (t * (c10 * t - c20) - c20)
    w5 = t2 * t2 * t
    w4 = np.float32(120.0) - w0 - w1 - w2 - w3 - w5
    return w0, w1, w2, w3, w4, w5


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True, inline="always")
def quintic_piece(c, tap, stride, out, at, ramp, count, tx, ux, uxx, ty, vx, vxx, offset):
    """As `cubic_piece`, with six taps each way: 14400 times the image."""
    a0 = tap
    a1 = a0 + stride
    a2 = a1 + stride
    a3 = a2 + stride
    a4 = a3 + stride
    a5 = a4 + stride
    for k in range(count // EIGHT * EIGHT):
        r = ramp[k]
        x0, x1, x2, x3, x4, x5 = quintic_weights(tx + r * (ux + r * uxx))
        y0, y1, y2, y3, y4, y5 = quintic_weights(ty + r * (vx + r * vxx))
        b0, b1, b2, b3, b4, b5 = a0 + k, a1 + k, a2 + k, a3 + k, a4 + k, a5 + k
        g0 = x0 * c[b0] + x1 * c[b0 + ONE] + x2 * c[b0 + TWO] + x3 * c[b0 + THREE] + x4 * c[b0 + FOUR] + x5 * c[b0 + FIVE]
        g1 = x0 * c[b1] + x1 * c[b1 + ONE] + x2 * c[b1 + TWO] + x3 * c[b1 + THREE] + x4 * c[b1 + FOUR] + x5 * c[b1 + FIVE]
        g2 = x0 * c[b2] + x1 * c[b2 + ONE] + x2 * c[b2 + TWO] + x3 * c[b2 + THREE] + x4 * c[b2 + FOUR] + x5 * c[b2 + FIVE]
        g3 = x0 * c[b3] + x1 * c[b3 + ONE] + x2 * c[b3 + TWO] + x3 * c[b3 + THREE] + x4 * c[b3 + FOUR] + x5 * c[b3 + FIVE]
        g4 = x0 * c[b4] + x1 * c[b4 + ONE] + x2 * c[b4 + TWO] + x3 * c[b4 + THREE] + x4 * c[b4 + FOUR] + x5 * c[b4 + FIVE]
        g5 = x0 * c[b5] + x1 * c[b5 + ONE] + x2 * c[b5 + TWO] + x3 * c[b5 + THREE] + x4 * c[b5 + FOUR] + x5 * c[b5 + FIVE]
        out[at + k] = (y0 * g0 + y1 * g1 + y2 * g2 + y3 * g3 + y4 * g4 + y5 * g5) - offset


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True, inline="always")
def cubic_at(c, tap, stride, tx, ty):
    """36 times the interpolated image at one position; `tap` is the first of four taps on the first of four rows."""
    one, three, four, six = np.float32(1.0), np.float32(3.0), np.float32(4.0), np.float32(6.0)
    ox, oy = one - tx, one - ty
    x0, x1 = ox * ox * ox, four + tx * tx * (three * tx - six)
    x2, x3 = four - ox * ox * (three * tx + three), tx * tx * tx
    y0, y1 = oy * oy * oy, four + ty * ty * (three * ty - six)
    y2, y3 = four - oy * oy * (three * ty + three), ty * ty * ty
    a0 = tap
    a1 = a0 + stride
    a2 = a1 + stride
    a3 = a2 + stride
    return (
        y0 * (x0 * c[a0] + x1 * c[a0 + ONE] + x2 * c[a0 + TWO] + x3 * c[a0 + THREE])
        + y1 * (x0 * c[a1] + x1 * c[a1 + ONE] + x2 * c[a1 + TWO] + x3 * c[a1 + THREE])
        + y2 * (x0 * c[a2] + x1 * c[a2 + ONE] + x2 * c[a2 + TWO] + x3 * c[a2 + THREE])
        + y3 * (x0 * c[a3] + x1 * c[a3 + ONE] + x2 * c[a3 + TWO] + x3 * c[a3 + THREE])
    )


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True, inline="always")
def quintic_at(c, tap, stride, tx, ty):
    """As `cubic_at`, with six taps each way: 14400 times the image."""
    x0, x1, x2, x3, x4, x5 = quintic_weights(tx)
    total = np.float32(0.0)
    at = tap
    for y in quintic_weights(ty):
        line = x0 * c[at] + x1 * c[at + ONE] + x2 * c[at + TWO] + x3 * c[at + THREE] + x4 * c[at + FOUR] + x5 * c[at + FIVE]
        total += y * line
        at += stride
    return total
