"""Storage of disparity maps and derived arrays in unnamed temporary files, which are memory-mapped while they are read."""

from __future__ import annotations

import contextlib
import mmap
import os
import tempfile
import threading
import weakref
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.estimate.storage import InMemoryStorage, Storage
from semlive.pipeline import AnalysisState

T = TypeVar("T", bound=np.generic)
_SLAB_BYTES = 64 * 2**20
_FILE_FRACTION = 8  # the size of a new file is the size of all earlier files over this number, so that there are dozens, not thousands
_ALIGNED = 64
_IN_MEMORY_BYTES = 256 * 2**20
_FLUSH_EVERY_S = 0.05  # in this time at most some 100 MB of pages are loaded


class MapStore(InMemoryStorage):
    """Stores maps and arrays: the first 256 MB in memory, the rest in temporary files.

    Arrays in files have equal values and the alignment of arrays in memory, so sums are bit by bit equal. `flush` returns the pages to the
    system, which loads them again on access. A file is removed when none of its arrays is in use.

    Args:
        in_memory_bytes: size of the part that is stored in memory, bytes.
        stays: store arrays in memory if the files have no space, instead of raising OSError.
    """

    def __init__(self, in_memory_bytes: int = _IN_MEMORY_BYTES, *, stays: bool = False) -> None:
        self._memory_bytes, self._stays = in_memory_bytes, stays
        self._file: int | None = None
        self._close: weakref.finalize[[int], MapStore] | None = None
        self._slabs: dict[int, weakref.ref[NDArray[np.uint8]]] = {}
        self._number = 0
        self._newest = np.zeros(0, dtype=np.uint8)
        self._used = self._allocated = 0
        self._lock = threading.Lock()  # pairs are read and stored while others are processed

    def store_map(self, disparity: DisparityMap) -> DisparityMap:
        """Return an equal map in this store."""
        arrays = {field.name: array for field in fields(disparity) if isinstance(array := getattr(disparity, field.name), np.ndarray)}
        if self._has_room(sum(array.nbytes for array in arrays.values())):
            return disparity
        return replace(disparity, **{name: self._store(array) for name, array in arrays.items()})

    def store_array(self, array: NDArray[T]) -> NDArray[T]:
        """Return an equal array in this store, without its base array; a non-contiguous array is returned unchanged."""
        if not array.flags.forc or self.location(array) is not None:
            return array
        if self._has_room(array.nbytes):
            return array if array.base is None else array.copy(order="K")
        return self._store(array)

    def location(self, array: NDArray[Any]) -> tuple[int, NDArray[np.uint8], int] | None:
        """Return number and bytes of the file that contains an array, and its first byte; None if no file contains it."""
        for number, slab in reversed(self._slabs.items()):
            base = slab()
            if base is not None and array.base is base:
                return number, base, array.ctypes.data - base.ctypes.data
        return None

    def flush(self) -> None:
        """Return pages to the system; their content stays in the files."""
        for slab in (reference() for reference in list(self._slabs.values())):
            if slab is not None and hasattr(mmap, "MADV_DONTNEED"):
                file: Any = slab.base  # a memoryview of the mapped file
                file.obj.madvise(mmap.MADV_DONTNEED)

    @contextlib.contextmanager
    def flushing(self) -> Iterator[None]:
        """Return pages to the system repeatedly within the context."""
        closed = threading.Event()

        def run() -> None:
            while not closed.wait(_FLUSH_EVERY_S):
                self.flush()

        thread = threading.Thread(target=run, name="map-store", daemon=True)
        thread.start()
        try:
            yield
        finally:
            closed.set()
            thread.join()
            self.flush()

    def _has_room(self, size: int) -> bool:
        """Reserve memory for a number of bytes; return whether the limit allows it."""
        with self._lock:
            is_allowed = size <= self._memory_bytes
            self._memory_bytes -= size if is_allowed else 0
            return is_allowed

    def _store(self, array: NDArray[T]) -> NDArray[T]:
        try:
            return self._write_to_file(array)
        except OSError:
            if not self._stays:
                raise
            return array

    def _write_to_file(self, array: NDArray[T]) -> NDArray[T]:
        size = -(-max(array.nbytes, 1) // _ALIGNED) * _ALIGNED
        order = "C" if array.flags.c_contiguous else "F"  # sums follow the order
        with self._lock:
            if self._used + size > len(self._newest):
                self._grow(size)
            begin = self._used
            self._used += size
            copy: NDArray[T] = self._newest[begin : begin + array.nbytes].view(array.dtype).reshape(array.shape, order=order)
            if self._file is not None and array.flags.forc and array.nbytes:
                # This takes half the time of copying into mapped pages, each of which would be loaded first.
                _write(self._file, (array if order == "C" else array.T).reshape(-1).view(np.uint8).data, begin)
            else:
                copy[...] = array
        copy.setflags(write=False)
        return copy

    def _grow(self, size: int) -> None:
        size = max(size, _SLAB_BYTES, self._allocated // _FILE_FRACTION)
        size = -(-size // mmap.ALLOCATIONGRANULARITY) * mmap.ALLOCATIONGRANULARITY
        self._allocated += size
        with tempfile.TemporaryFile(prefix="semlive-maps-", buffering=0) as file:
            file.truncate(size)
            slab = mmap.mmap(file.fileno(), size)  # with a separate handle
            if hasattr(os, "pwrite"):
                if self._close is not None:
                    self._close()
                self._file = os.dup(file.fileno())
                self._close = weakref.finalize(self, os.close, self._file)
                self._close.atexit = False  # threads may still write; the end of the process closes it
        self._newest, self._used, self._number = np.frombuffer(slab, dtype=np.uint8), 0, self._number + 1
        in_use = {number: reference for number, reference in self._slabs.items() if reference() is not None}
        self._slabs = {**in_use, self._number: weakref.ref(self._newest)}


def offload_pair(state: AnalysisState, pair: int, stored: tuple[DisparityMap, ...], store: Storage) -> AnalysisState:
    """Return the state with the data of its newest pair in the store: columns, and maps from frame 0. Later pairs are stored there too.

    Args:
        state: state of the analysis.
        pair: number of the newest pair.
        stored: maps of the pair that are stored already; maps of `pipeline.analyse` need not be listed.
        store: destination.

    Raises:
        OSError: there is no space for the data.
    """
    estimator = state.method.offload(state.estimator_state, pair, store)
    if state.storage is store:
        return replace(state, estimator_state=estimator)
    newest = [
        disparity if disparity in stored or disparity.current // 2 != pair else store.store_map(disparity)
        for disparity in state.maps_from_reference[-2:]
    ]
    return replace(
        state, maps_from_reference=store.append(state.maps_from_reference[:-2], newest), estimator_state=estimator, storage=store
    )


def _write(file: int, data: memoryview, at: int) -> None:
    while data:
        done = os.pwrite(file, data, at)
        data, at = data[done:], at + done
