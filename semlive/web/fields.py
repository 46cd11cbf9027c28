"""Maps for the browser: float32, row-major, NaN at invalid points; stored in temporary files."""

from __future__ import annotations

import tempfile
import threading
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from typing import IO

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.formats.log.maps import decode_displacement, decode_map, decode_strain
from semlive.formats.log.messages import DIC_MAP, DISPLACEMENT_FIELD, STRAIN_FIELD
from semlive.formats.log.reader import LogMessage
from semlive.web.page_state import MapQuality


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Maps of one frame.

    Attributes:
        frame: number of the frame.
        grid: grid of the map points.
        values: (ny, nx) float32 each, by name: disparity_u, disparity_v, disparity_sigma_u, disparity_sigma_v, zncc (of a disparity from
            frame 0), displacement_u, displacement_v, displacement_sigma_u, displacement_sigma_v (px), exx, eyy, exy.
        quality: correlation quality, for a disparity map.
        shift_px: median disparity from frame 0; None for other maps.
    """

    frame: int
    grid: Grid
    values: Mapping[str, NDArray[np.float32]]
    quality: MapQuality | None = None
    shift_px: tuple[float, float] | None = None


def fields_of(message: LogMessage) -> Fields | None:
    """Return the maps in a message; None if there are none.

    Raises:
        BadLog: the bytes are not a map.
    """
    if message.topic == DIC_MAP:
        disparity = decode_map(message.payload)
        valid = disparity.valid
        shown = {
            "disparity_u": disparity.u_px,
            "disparity_v": disparity.v_px,
            "disparity_sigma_u": disparity.sigma_u_px,
            "disparity_sigma_v": disparity.sigma_v_px,
            "zncc": disparity.zncc,
        }
        if disparity.reference != 0:
            return Fields(disparity.current, disparity.grid, {}, _quality(disparity))
        return Fields(disparity.current, disparity.grid, _masked(shown, valid), _quality(disparity), _shift(disparity))
    if message.topic == DISPLACEMENT_FIELD:
        moved = decode_displacement(message.payload)
        shown = {
            "displacement_u": moved.u_px,
            "displacement_v": moved.v_px,
            "displacement_sigma_u": moved.sigma_u_px,
            "displacement_sigma_v": moved.sigma_v_px,
        }
        return Fields(moved.frame, moved.grid, _masked(shown, moved.valid))
    if message.topic == STRAIN_FIELD:
        strain = decode_strain(message.payload)
        return Fields(strain.frame, strain.grid, _masked({name: getattr(strain, name) for name in ("exx", "eyy", "exy")}, strain.valid))
    return None


def _shift(disparity: DisparityMap) -> tuple[float, float] | None:
    valid = disparity.valid
    if not valid.any():
        return None
    return round(float(np.median(disparity.u_px[valid])), 2), round(float(np.median(disparity.v_px[valid])), 2)


def _quality(disparity: DisparityMap) -> MapQuality:
    valid = disparity.valid
    noise_px = float(disparity.sigma_u_px[valid].mean()) if valid.any() else None
    zncc = float(np.median(disparity.zncc[valid])) if valid.any() else None
    return MapQuality(disparity.reference, disparity.current, int(valid.sum()), valid.size, noise_px, zncc)


def _masked(fields: Mapping[str, NDArray[np.float64]], valid: NDArray[np.bool_]) -> dict[str, NDArray[np.float32]]:
    return {name: np.where(valid, field, np.nan).astype("<f4") for name, field in fields.items()}


class FieldStore:
    """Maps in a temporary file that is removed with the process; its size is about a sixth of that of the log."""

    def __init__(self) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(prefix="semlive-page-")  # noqa: SIM115 - as long as the store
        weakref.finalize(self, self._file.close)
        self._places: dict[tuple[int, str], tuple[int, int]] = {}
        self._lock = threading.Lock()

    def store(self, fields: Fields) -> None:
        """Store maps; a map replaces an earlier one of the same frame and name."""
        with self._lock:
            for name, field in fields.values.items():
                data, place = field.tobytes(), self._places.get((fields.frame, name))
                begin = place[0] if place is not None and place[1] == len(data) else self._file.seek(0, 2)
                self._file.seek(begin)
                self._file.write(data)
                self._places[(fields.frame, name)] = (begin, len(data))

    def read(self, frame: int, name: str) -> bytes | None:
        """Return the bytes of a map, or None if there is none."""
        with self._lock:
            place = self._places.get((frame, name))
            if place is None:
                return None
            self._file.seek(place[0])
            return self._file.read(place[1])
