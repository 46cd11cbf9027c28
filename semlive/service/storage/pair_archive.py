"""Storage of the pairs of a live run, packed in unnamed files and read back value by value on request."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.service.storage.map_store import MapStore

V = TypeVar("V")
Places = NDArray[np.int64]
"""(n, 2) number of the file and byte in it of each value; -1 and a number for a value in memory."""

_SHARED, _INTEGER, _REAL, _TEXT, _ARRAY, _TUPLE, _OBJECT = range(7)  # type codes in the stored integers
_IN_MEMORY = -1


class PairArchive:
    """Stores values as 64-bit integers in files; memory holds 16 bytes for each value, and parts that many values share.

    A value consists of data classes, tuples, arrays, numbers, texts, and hashable objects (None, members of enumerations, ...), which
    are stored once and permanently. A value is read as an equal object, with the same numbers in arrays of the same alignment. Values
    without space in files stay in memory.
    """

    def __init__(self) -> None:
        self._store, self._passing = MapStore(0, stays=True), MapStore(0, stays=True)
        self._numbers: dict[Any, int] = {}
        self._shared: list[Any] = []

    def store_map(self, disparity: DisparityMap) -> DisparityMap:
        """Return an equal map in this store."""
        return self._store.store_map(disparity)

    def store_array(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return an equal array in this store."""
        return self._store.store_array(array)

    def store_transient(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return an equal array in a file that is removed when none of its arrays is in use."""
        return self._passing.store_array(array)

    def flush(self) -> None:
        """Return pages to the system; their content stays in the files."""
        self._store.flush()
        self._passing.flush()

    def append(self, history: Sequence[V], new: Iterable[V]) -> Sequence[V]:
        """Return the history with new values at its end."""
        before = history if isinstance(history, StoredSequence) else StoredSequence[V](self).appended(history)
        return before.appended(new)

    def update(self, stored: Mapping[int, V], new: Mapping[int, V]) -> Mapping[int, V]:
        """The stored values with the new ones, which replace values of the same number."""
        before = stored if isinstance(stored, StoredMapping) else StoredMapping[V](self).updated(stored)
        return before.updated(new)

    def packed(self, value: Any) -> tuple[tuple[int, int], dict[int, NDArray[np.uint8]]]:
        """Store a value; return its place, and the files that contain it by number.

        Raises:
            TypeError: it is, or contains, an object that cannot be stored.
        """
        words, files = list[int](), dict[int, NDArray[np.uint8]]()
        self._write(value, words, files)
        location = self._store.location(self._store.store_array(np.array([len(words), *words], dtype=np.int64)))
        if location is None:
            return (_IN_MEMORY, self._in_memory(value)), {}
        number, file, at = location
        return (number, at), {**files, number: file}

    def unpacked(self, place: tuple[int, int], files: Mapping[int, NDArray[np.uint8]]) -> Any:
        """Return the value at a place."""
        number, at = place
        if number == _IN_MEMORY:
            return self._shared[at]
        count = int(files[number][at : at + 8].view(np.int64)[0])
        words = files[number][at + 8 : at + 8 * (1 + count)].view(np.int64).tolist()
        return self._read(iter(words), files)

    def _write(self, value: Any, words: list[int], files: dict[int, NDArray[np.uint8]]) -> None:
        kind = type(value)
        if kind is int and -(2**63) <= value < 2**63:
            words += (_INTEGER, value)
        elif kind is float:
            words += (_REAL, *struct.unpack("q", struct.pack("d", value)))
        elif kind is str:
            data = value.encode()
            words += (_TEXT, len(data), *np.frombuffer(data.ljust(-(-len(data) // 8) * 8, b"\0"), dtype=np.int64).tolist())
        elif kind is np.ndarray:
            self._write_array(value, words, files)
        elif kind is tuple:
            words += (_TUPLE, len(value))
            for item in value:
                self._write(item, words, files)
        elif is_dataclass(value):
            words += (_OBJECT, self._number_of(kind))
            for name in _names(kind):
                self._write(getattr(value, name), words, files)
        else:
            words += (_SHARED, self._number_of(value))

    def _write_array(self, array: NDArray[Any], words: list[int], files: dict[int, NDArray[np.uint8]]) -> None:
        if not array.size:
            words += (_SHARED, self._number_of(("empty", array.dtype.str, array.shape), array.copy()))
            return
        location = self._store.location(self._store.store_array(array))
        if location is None:
            words += (_SHARED, self._in_memory(array))
            return
        number, file, at = location
        files[number] = file
        layout = self._number_of((array.dtype.str, "C" if array.flags.c_contiguous else "F"))
        words += (_ARRAY, layout, number, at, array.ndim, *array.shape)

    def _read(self, words: Iterator[int], files: Mapping[int, NDArray[np.uint8]]) -> Any:
        kind, value = next(words), next(words)
        if kind == _SHARED:
            return self._shared[value]
        if kind == _INTEGER:
            return value
        if kind == _REAL:
            return struct.unpack("d", struct.pack("q", value))[0]
        if kind == _TEXT:
            return b"".join(struct.pack("q", next(words)) for _ in range(-(-value // 8)))[:value].decode()
        if kind == _TUPLE:
            return tuple(self._read(words, files) for _ in range(value))
        if kind == _OBJECT:
            kind_of_object = self._shared[value]
            return kind_of_object(*(self._read(words, files) for _ in _names(kind_of_object)))
        name, order = self._shared[value]
        number, at, dimensions = next(words), next(words), next(words)
        shape, dtype = tuple(next(words) for _ in range(dimensions)), np.dtype(name)
        size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        array = files[number][at : at + size].view(dtype).reshape(shape, order=order)
        array.setflags(write=False)
        return array

    def _number_of(self, key: Any, value: Any = None) -> int:
        """Return the number of an object that many values share; without a value the key itself is the object."""
        if key not in self._numbers:
            self._numbers[key] = self._in_memory(key if value is None else value)
        return self._numbers[key]

    def _in_memory(self, value: Any) -> int:
        self._shared.append(value)
        return len(self._shared) - 1


class StoredSequence(Sequence[V]):
    """Immutable sequence of stored values; appending returns another sequence.

    Args:
        archive: archive that reads and writes the values.
        places: places of the values; None for none.
        files: files that contain them, by number.
    """

    def __init__(self, archive: PairArchive, places: Places | None = None, files: Mapping[int, NDArray[np.uint8]] | None = None) -> None:
        self._archive = archive
        self._places = np.zeros((0, 2), dtype=np.int64) if places is None else places
        self._files = files or {}

    def appended(self, new: Iterable[V]) -> StoredSequence[V]:
        """Return a sequence with new values at its end."""
        places, files = list[tuple[int, int]](), dict(self._files)
        for value in new:
            place, own = self._archive.packed(value)
            places.append(place)
            files.update(own)
        if not places:
            return self
        return StoredSequence(self._archive, np.concatenate((self._places, np.array(places, dtype=np.int64))), files)

    def with_cache(self, at: NDArray[np.int64]) -> StoredSequence[V]:
        """Return a selection in another order."""
        return StoredSequence(self._archive, self._places[at], self._files)

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, at: int) -> V: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[V]: ...
    def __getitem__(self, at: int | slice) -> V | Sequence[V]:
        """Read a value, or a slice as a tuple; each call returns new objects."""
        if isinstance(at, slice):
            return tuple(self[index] for index in range(*at.indices(len(self))))
        number, begin = self._places[at].tolist()
        value: V = self._archive.unpacked((number, begin), self._files)
        return value


class StoredMapping(Mapping[int, V]):
    """Immutable mapping of numbers to stored values; an update returns another mapping.

    Args:
        archive: archive that reads and writes the values.
        values: the values; None for none.
        numbers: (n,) their numbers, ascending.
    """

    def __init__(self, archive: PairArchive, values: StoredSequence[V] | None = None, numbers: NDArray[np.int64] | None = None) -> None:
        self._archive = archive
        self._values = StoredSequence[V](archive) if values is None else values
        self._numbers = np.zeros(0, dtype=np.int64) if numbers is None else numbers

    def updated(self, new: Mapping[int, V]) -> StoredMapping[V]:
        """Return a mapping with new values, which replace values of the same number."""
        if not new:
            return self
        both = np.concatenate((self._numbers, np.array(list(new), dtype=np.int64)))
        numbers, last = np.unique(both[::-1], return_index=True)
        values = self._values.appended(new.values()).with_cache(len(both) - 1 - last)
        return StoredMapping(self._archive, values, numbers)

    def __getitem__(self, number: int) -> V:
        at = int(np.searchsorted(self._numbers, number))
        if at == len(self._numbers) or self._numbers[at] != number:
            raise KeyError(number)
        return self._values[at]

    def __iter__(self) -> Iterator[int]:
        return iter(self._numbers.tolist())

    def __len__(self) -> int:
        return len(self._numbers)


@lru_cache(maxsize=256)
def _names(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))
