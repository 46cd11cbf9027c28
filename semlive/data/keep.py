"""Where what a run holds for good is kept: in memory as it is, or by somebody else who gives the same numbers back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap

V = TypeVar("V")


class Keep(Protocol):
    """Keeps values, which never change."""

    def map(self, disparity: DisparityMap) -> DisparityMap:
        """The same map."""
        ...

    def array(self, array: NDArray[Any]) -> NDArray[Any]:
        """The same numbers in an array of the same shape and order."""
        ...

    def passing(self, array: NDArray[Any]) -> NDArray[Any]:
        """The same for an array that the next pair's takes the place of."""
        ...

    def longer(self, history: Sequence[V], new: Iterable[V]) -> Sequence[V]:
        """Everything so far and, after it, what is new: equal values, not the same objects."""
        ...

    def updated(self, known: Mapping[int, V], new: Mapping[int, V]) -> Mapping[int, V]:
        """Everything known with what is new, in place of what had its number; likewise."""
        ...


class InMemory:
    """Everything stays as it is."""

    def map(self, disparity: DisparityMap) -> DisparityMap:
        """The map itself."""
        return disparity

    def array(self, array: NDArray[Any]) -> NDArray[Any]:
        """The array itself."""
        return array

    def passing(self, array: NDArray[Any]) -> NDArray[Any]:
        """The array itself."""
        return array

    def longer(self, history: Sequence[V], new: Iterable[V]) -> Sequence[V]:
        """A tuple."""
        return (*history, *new)

    def updated(self, known: Mapping[int, V], new: Mapping[int, V]) -> Mapping[int, V]:
        """A dictionary."""
        return {**known, **new}


IN_MEMORY = InMemory()
