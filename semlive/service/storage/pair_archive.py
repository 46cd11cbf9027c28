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
"""(n, 2) number of the file and byte in it of each value; -1 and a number of what is held in memory."""

_SHARED, _INTEGER, _REAL, _TEXT, _ARRAY, _TUPLE, _OBJECT = range(7)  # what a word says of those behind it
_IN_MEMORY = -1


class PairArchive:
    """Keeps values as words of 64 bits in a store: all but 16 bytes of a value, and what many values share, lies in its files.

    A value is made of data classes, tuples, arrays, numbers, texts, and of what can be hashed (None, members of enumerations, ...), which
    is held once, for good. It comes back equal: another object, with the same numbers in arrays on the same boundaries. What finds no
    room in files stays in memory.
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
        """Everything so far and, after it, what is new."""
        before = history if isinstance(history, StoredSequence) else StoredSequence[V](self).appended(history)
        return before.appended(new)

    def update(self, stored: Mapping[int, V], new: Mapping[int, V]) -> Mapping[int, V]:
        """The stored values with the new ones, which replace values of the same number."""
        before = stored if isinstance(stored, StoredMapping) else StoredMapping[V](self).updated(stored)
        return before.updated(new)

    def packed(self, value: Any) -> tuple[tuple[int, int], dict[int, NDArray[np.uint8]]]:
        """Where a value now lies, and the files that hold it, by number.

        Raises:
            TypeError: it is, or has, something of which no value can be made.
        """
        words, files = list[int](), dict[int, NDArray[np.uint8]]()
        self._write(value, words, files)
        found = self._store.location(self._store.store_array(np.array([len(words), *words], dtype=np.int64)))
        if found is None:
            return (_IN_MEMORY, self._held(value)), {}
        number, file, at = found
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
            for one in value:
                self._write(one, words, files)
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
        found = self._store.location(self._store.store_array(array))
        if found is None:
            words += (_SHARED, self._held(array))
            return
        number, file, at = found
        files[number] = file
        how = self._number_of((array.dtype.str, "C" if array.flags.c_contiguous else "F"))
        words += (_ARRAY, how, number, at, array.ndim, *array.shape)

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
            made = self._shared[value]
            return made(*(self._read(words, files) for _ in _names(made)))
        name, order = self._shared[value]
        number, at, dimensions = next(words), next(words), next(words)
        shape, dtype = tuple(next(words) for _ in range(dimensions)), np.dtype(name)
        size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        array = files[number][at : at + size].view(dtype).reshape(shape, order=order)
        array.setflags(write=False)
        return array

    def _number_of(self, key: Any, value: Any = None) -> int:
        """The number of what many values share: the key, if it is not said what."""
        if key not in self._numbers:
            self._numbers[key] = self._held(key if value is None else value)
        return self._numbers[key]

    def _held(self, value: Any) -> int:
        self._shared.append(value)
        return len(self._shared) - 1


class StoredSequence(Sequence[V]):
    """Values one after another; what is added gives another shelf, and this one stays as it is.

    Args:
        archive: that reads and writes them.
        places: of the values.
        files: that hold them, by number.
    """

    def __init__(self, archive: PairArchive, places: Places | None = None, files: Mapping[int, NDArray[np.uint8]] | None = None) -> None:
        self._archive = archive
        self._places = np.zeros((0, 2), dtype=np.int64) if places is None else places
        self._files = files or {}

    def appended(self, new: Iterable[V]) -> StoredSequence[V]:
        """These and, behind them, what is new."""
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
        """One value; or some as a tuple, each another object whenever it is asked for."""
        if isinstance(at, slice):
            return tuple(self[one] for one in range(*at.indices(len(self))))
        number, begin = self._places[at].tolist()
        found: V = self._archive.unpacked((number, begin), self._files)
        return found


class StoredMapping(Mapping[int, V]):
    """Values by number; what is added gives another drawer, and this one stays as it is.

    Args:
        archive: that reads and writes them.
        shelf: the values.
        numbers: (n,) their numbers, ascending.
    """

    def __init__(self, archive: PairArchive, shelf: StoredSequence[V] | None = None, numbers: NDArray[np.int64] | None = None) -> None:
        self._archive = archive
        self._shelf = StoredSequence[V](archive) if shelf is None else shelf
        self._numbers = np.zeros(0, dtype=np.int64) if numbers is None else numbers

    def updated(self, new: Mapping[int, V]) -> StoredMapping[V]:
        """These, and what is new in place of what had its number."""
        if not new:
            return self
        both = np.concatenate((self._numbers, np.array(list(new), dtype=np.int64)))
        numbers, last = np.unique(both[::-1], return_index=True)
        shelf = self._shelf.appended(new.values()).with_cache(len(both) - 1 - last)
        return StoredMapping(self._archive, shelf, numbers)

    def __getitem__(self, number: int) -> V:
        at = int(np.searchsorted(self._numbers, number))
        if at == len(self._numbers) or self._numbers[at] != number:
            raise KeyError(number)
        return self._shelf[at]

    def __iter__(self) -> Iterator[int]:
        return iter(self._numbers.tolist())

    def __len__(self) -> int:
        return len(self._numbers)


@lru_cache(maxsize=256)
def _names(kind: type) -> tuple[str, ...]:
    return tuple(one.name for one in fields(kind))
