"""Storage of the arrays that a run keeps until its end: an interface, and its implementation in memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap

V = TypeVar("V")


class Storage(Protocol):
    """Storage of immutable values; a stored array has the same numbers, shape and order."""

    def store_map(self, disparity: DisparityMap) -> DisparityMap:
        """Store a map; returns an equal map."""
        ...

    def store_array(self, array: NDArray[Any]) -> NDArray[Any]:
        """Store an array; returns an equal array."""
        ...

    def store_transient(self, array: NDArray[Any]) -> NDArray[Any]:
        """Store an array until the array of the next pair replaces it; returns an equal array."""
        ...

    def append(self, history: Sequence[V], new: Iterable[V]) -> Sequence[V]:
        """The history followed by the new values; values are equal, objects may differ."""
        ...

    def update(self, stored: Mapping[int, V], new: Mapping[int, V]) -> Mapping[int, V]:
        """The stored values with the new ones, which replace values of the same number; values are equal, objects may differ."""
        ...


class InMemoryStorage:
    """Storage in the memory of the process; returns its arguments."""

    def store_map(self, disparity: DisparityMap) -> DisparityMap:
        """Return the map."""
        return disparity

    def store_array(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the array."""
        return array

    def store_transient(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the array."""
        return array

    def append(self, history: Sequence[V], new: Iterable[V]) -> Sequence[V]:
        """Return a tuple of the history and the new values."""
        return (*history, *new)

    def update(self, stored: Mapping[int, V], new: Mapping[int, V]) -> Mapping[int, V]:
        """Return a dictionary of both."""
        return {**stored, **new}


IN_MEMORY = InMemoryStorage()
