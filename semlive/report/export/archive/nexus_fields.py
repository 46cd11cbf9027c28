"""Corrected fields of all frames as stacks over (frame, y, x), one group NXdata for each quantity."""

from __future__ import annotations

from collections.abc import Mapping

import h5py
import numpy as np

from semlive.report.export.archive.nexus_nodes import Value, add_field, add_group, mark_data, set_units
from semlive.report.export.fields import UNITS, Array

_TITLES = {
    "u": "displacement along x, corrected, from frame 0",
    "v": "displacement along y, corrected, from frame 0",
    "exx": "strain along x, tension positive",
    "eyy": "strain along y, tension positive",
    "exy": "tensor shear strain",
}
_UNCERTAINTIES: Mapping[str, Mapping[str, str]] = {
    "u": {"sigma_u": "u_errors", "systematic_u": "u_systematic"},
    "v": {"sigma_v": "v_errors", "systematic_v": "v_systematic"},
}


class FieldStacks:
    """Stacks that grow by one frame at a time; NaN where not measured.

    Args:
        parent: group of the stacks.
    """

    def __init__(self, parent: h5py.Group) -> None:
        self._parent = parent
        self._groups: dict[str, h5py.Group] = {}
        self._stacks: dict[str, h5py.Dataset] = {}
        self._numbers: list[int] = []

    def append(self, number: int, arrays: Mapping[str, Array]) -> None:
        """Append a frame.

        Args:
            number: number of the frame.
            arrays: (ny, nx) fields by name, as `semlive.report.export.fields.frame_fields` returns them.
        """
        if not self._groups:
            for name in _TITLES:
                self._add_group(name, arrays)
        at = len(self._numbers)
        for name, stack in self._stacks.items():
            stack.resize(at + 1, axis=0)
            stack[at] = np.where(arrays["strain_valid" if name.startswith("e") else "valid"], arrays[name], np.nan)
        self._numbers.append(number)

    def finish(self, x_px: Array, y_px: Array, pixel_size_um: float | None) -> None:
        """Add the axes: numbers of the frames, coordinates in px and, where the pixel size is known, in micrometres."""
        axes: dict[str, tuple[Value, str, int]] = {"frame": (np.array(self._numbers), "", 0), "y": (y_px, "px", 1), "x": (x_px, "px", 2)}
        if pixel_size_um is not None:
            axes |= {"y_um": (y_px * pixel_size_um, "um", 1), "x_um": (x_px * pixel_size_um, "um", 2)}
        first, *others = self._groups.values()
        for name, (values, unit, dimension) in axes.items():
            axis = add_field(first, name, values, unit)
            for group in others:
                group[name] = axis
            for group in self._groups.values():
                group.attrs[f"{name}_indices"] = np.uint32(dimension)

    def _add_group(self, name: str, arrays: Mapping[str, Array]) -> None:
        group = add_group(self._parent, name, "NXdata", title=_TITLES[name])
        mark_data(group, ("frame", "y", "x"), name)
        self._groups[name] = group
        self._add_stack(group, name, name, arrays[name], _TITLES[name])
        for source, stored in _UNCERTAINTIES.get(name, {}).items():
            if source in arrays:
                kind = "standard uncertainty" if stored.endswith("_errors") else "part of the uncertainty that all points share"
                self._add_stack(group, source, stored, arrays[source], f"{kind} of {name}")

    def _add_stack(self, group: h5py.Group, source: str, stored: str, array: Array, text: str) -> None:
        shape = array.shape
        stack = group.create_dataset(
            stored, (0, *shape), "f8", maxshape=(None, *shape), chunks=(1, *shape), compression="gzip", shuffle=True
        )
        set_units(stack, UNITS[source])
        stack.attrs["long_name"] = text
        self._stacks[source] = stack
