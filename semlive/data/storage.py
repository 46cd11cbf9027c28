"""Where what a run holds for good is kept: in memory as it is, or by somebody else who gives the same numbers back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap

V = TypeVar("V")


class Storage(Protocol):
    """Keeps values, which never change."""

    def store_map(self, disparity: DisparityMap) -> DisparityMap:
        """The same map."""
        ...

    def store_array(self, array: NDArray[Any]) -> NDArray[Any]:
        """The same numbers in an array of the same shape and order."""
        ...

    def store_transient(self, array: NDArray[Any]) -> NDArray[Any]:
        """The same for an array that the next pair's takes the place of."""
        ...

    def append(self, history: Sequence[V], new: Iterable[V]) -> Sequence[V]:
        """Everything so far and, after it, what is new: equal values, not the same objects."""
        ...

    def update(self, stored: Mapping[int, V], new: Mapping[int, V]) -> Mapping[int, V]:
        """Return a mapping with new values, which replace values of the same number."""
        ...


class InMemoryStorage:
    """Everything stays as it is."""

    def store_map(self, disparity: DisparityMap) -> DisparityMap:
        """The map itself."""
        return disparity

    def store_array(self, array: NDArray[Any]) -> NDArray[Any]:
        """The array itself."""
        return array

    def store_transient(self, array: NDArray[Any]) -> NDArray[Any]:
        """The array itself."""
        return array

    def append(self, history: Sequence[V], new: Iterable[V]) -> Sequence[V]:
        """A tuple."""
        return (*history, *new)

    def update(self, stored: Mapping[int, V], new: Mapping[int, V]) -> Mapping[int, V]:
        """A dictionary."""
        return {**stored, **new}


IN_MEMORY = InMemoryStorage()
