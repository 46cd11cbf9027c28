"""Groups and fields of a NeXus file: https://manual.nexusformat.org."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

Value = str | bool | int | float | np.generic | NDArray[Any] | Sequence[str]
_NEXUS_UNITS = {"px": "pixel", "1": "", "deg": "degree"}


def add_group(parent: h5py.Group, name: str, nx_class: str, /, **fields: Value | tuple[Value, str] | None) -> h5py.Group:
    """Add a group with fields.

    Args:
        parent: where it is added.
        name: its name.
        nx_class: its base class, as in ``NXdata``.
        fields: values by name, with their unit if there is one; None is left out.
    """
    group = parent.create_group(name)
    group.attrs["NX_class"] = nx_class
    for key, value in fields.items():
        if isinstance(value, tuple):
            add_field(group, key, value[0], value[1])
        else:
            add_field(group, key, value)
    return group


def add_field(group: h5py.Group, name: str, value: Value | None, units: str | None = None) -> h5py.Dataset | None:
    """Add a field; arrays are compressed by gzip, which every HDF5 library reads.

    Args:
        group: where it is added.
        name: its name.
        value: its value; None adds nothing.
        units: its unit; ``px`` becomes ``pixel``, ``1`` becomes empty.
    """
    if value is None:
        return None
    if isinstance(value, str) or (isinstance(value, Sequence) and not isinstance(value, np.ndarray)):
        field = group.create_dataset(name, data=value, dtype=h5py.string_dtype())
    elif isinstance(value, np.ndarray) and value.size > 1:
        field = group.create_dataset(name, data=value, compression="gzip", shuffle=True)
    else:
        field = group.create_dataset(name, data=value)
    if units is not None:
        set_units(field, units)
    return field


def set_units(field: h5py.Dataset, units: str) -> None:
    """Set the unit of a field; a dimensionless field has an empty one."""
    field.attrs["units"] = _NEXUS_UNITS.get(units, units)


def add_data(
    parent: h5py.Group,
    name: str,
    axes: Sequence[str],
    signals: Mapping[str, tuple[Value, str]],
    coordinates: Mapping[str, tuple[Value, str]],
) -> h5py.Group:
    """Add a group NXdata.

    Args:
        parent: where it is added.
        name: its name.
        axes: names of the coordinates of each dimension.
        signals: values with unit by name; the first is the default plot, names that end in ``_errors`` are standard uncertainties.
        coordinates: values with unit by name.
    """
    group = add_group(parent, name, "NXdata", **coordinates, **signals)
    plotted = [signal for signal in signals if not signal.endswith("_errors")]
    mark_data(group, axes, plotted[0], plotted[1:])
    return group


def mark_data(group: h5py.Group, axes: Sequence[str], signal: str, auxiliary: Sequence[str] = ()) -> None:
    """Set the attributes that define the plot of a group NXdata."""
    group.attrs["signal"] = signal
    group.attrs["axes"] = np.array(axes, dtype=h5py.string_dtype())
    for dimension, axis in enumerate(axes):
        group.attrs[f"{axis}_indices"] = np.uint32(dimension)
    if auxiliary:
        group.attrs["auxiliary_signals"] = np.array(auxiliary, dtype=h5py.string_dtype())


def iso_time(time_ns: int) -> str:
    """Return an instant as ISO 8601 with microseconds, UTC."""
    return datetime.fromtimestamp(time_ns / 1e9, UTC).isoformat(timespec="microseconds")
