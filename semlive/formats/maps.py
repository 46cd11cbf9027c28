"""Disparity maps as compact bytes, exact: what is decoded has the very numbers that the estimator used.

Layout, little endian: magic ``SLDM``, u16 version 1, u16 zero, then i32 reference, current, x0, y0, step, nx, ny, subset; then
nx * ny float64 each of u, v, sigma_u, sigma_v, zncc, row by row, and nx * ny bytes of status. 41 bytes a point: 0.74 MB for 18,000.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.errors import BadLog

_HEAD = struct.Struct("<4sHH8i")
_MAGIC, _VERSION = b"SLDM", 1
_FIELDS = 5
_MAX_POINTS = 10**8


def encode_map(disparity: DisparityMap) -> bytes:
    """A disparity map as bytes."""
    grid = disparity.grid
    numbers = (disparity.reference, disparity.current, grid.x0_px, grid.y0_px, grid.step_px, grid.nx, grid.ny, grid.subset_px)
    fields = (disparity.u_px, disparity.v_px, disparity.sigma_u_px, disparity.sigma_v_px, disparity.zncc)
    parts = [np.ascontiguousarray(field, dtype="<f8").tobytes() for field in fields]
    return b"".join((_HEAD.pack(_MAGIC, _VERSION, 0, *numbers), *parts, np.ascontiguousarray(disparity.status, dtype=np.uint8).tobytes()))


def decode_map(payload: bytes) -> DisparityMap:
    """A disparity map from bytes.

    Raises:
        BadLog: they are no disparity map of a known version.
    """
    if len(payload) < _HEAD.size:
        raise BadLog(f"/dic/map: {len(payload)} bytes are no disparity map; recompute from the images.")
    magic, version, _, reference, current, x0, y0, step, nx, ny, subset = _HEAD.unpack_from(payload)
    if magic != _MAGIC or version != _VERSION:
        raise BadLog(f"/dic/map: no disparity map of version {_VERSION}; read this log with the version of semlive that wrote it.")
    points = nx * ny
    if nx < 1 or ny < 1 or points > _MAX_POINTS or len(payload) != _HEAD.size + points * (8 * _FIELDS + 1):
        raise BadLog(f"/dic/map: {len(payload)} bytes do not hold {nx} x {ny} points; recompute from the images.")
    fields = np.frombuffer(payload, "<f8", _FIELDS * points, _HEAD.size).reshape(_FIELDS, ny, nx)
    status = np.frombuffer(payload, np.uint8, points, _HEAD.size + 8 * _FIELDS * points).reshape(ny, nx)
    if status.max() > max(PoiStatus):
        raise BadLog("/dic/map: a point has an unknown status; read this log with the version of semlive that wrote it.")
    u, v, sigma_u, sigma_v, zncc = (_native(field) for field in fields)
    return DisparityMap(reference, current, Grid(x0, y0, step, nx, ny, subset), u, v, sigma_u, sigma_v, zncc, status.copy())


def _native(field: NDArray[np.float64]) -> NDArray[np.float64]:
    return field.astype(np.float64)
