"""Settling of the beam at the start of rows and of frames: in time, or in position on the specimen; with one length or two.

In time, the extent in pixels depends on the dwell or row time and not on the pixel size; in position, on the pixel size and not on the
scan times. A multi-beam microscope follows the position (templiert/scan_correction). Frames of one pixel size and one dwell time show the
same displacement by both laws, and it is part of the distortion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np

from semlive.model.effects.effect_class import (
    BasisField,
    EffectClass,
    NonlinearParameter,
    ReportedParameter,
    Values,
    values_grid,
    xy_parameters,
)
from semlive.model.effects.run_geometry import Array, RunGeometry, field_column, xy_columns

Decay = Callable[[RunGeometry, float], Array]
Field = Callable[[RunGeometry, Values], BasisField]
FLYBACK_SETTLING_S = tuple(np.geomspace(1e-4, 2e-2, 12))
FRAME_START_SETTLING_S = tuple(np.geomspace(0.3, 30.0, 10))
LENGTHS_PX = tuple(np.geomspace(5.0, 500.0, 11))
TWO_TERMS = "_two_terms"
SECOND = "second_"
MIN_RATIO = 2.5
"""Smallest ratio of two lengths on the grid; closer ones are one length within noise."""


def _row_in_time(scene: RunGeometry, constant: float) -> Array:
    return np.asarray(np.exp(-scene.time_in_row_s / constant))


def _frame_in_time(scene: RunGeometry, constant: float) -> Array:
    return np.asarray(np.exp(-scene.row_start_s / constant))


def _row_in_position(scene: RunGeometry, constant: float) -> Array:
    return np.asarray(np.exp(-scene.pixel_ratio * scene.pixel_px[..., 0] / constant))


def _frame_in_position(scene: RunGeometry, constant: float) -> Array:
    return np.asarray(np.exp(-scene.pixel_ratio * scene.pixel_px[..., 1] / constant))


def _row_settling(decay: Decay, name: str) -> Field:
    def basis_field(scene: RunGeometry, values: Values) -> BasisField:
        """Along x, A exp(-x / L)."""
        fall = decay(scene, values[name])
        return BasisField(field_column(fall, np.zeros_like(fall)), (ReportedParameter("amplitude_px", "px", np.ones(1)),))

    return basis_field


def _frame_settling(decay: Decay, name: str) -> Field:
    def basis_field(scene: RunGeometry, values: Values) -> BasisField:
        """(u, v) = A exp(-y / L)."""
        return BasisField(xy_columns(decay(scene, values[name])), xy_parameters("px"))

    return basis_field


_OTHER_SCAN = "settling changes its extent, the distortion does not"
_BY_TIME = f"the calibration again with half or twice the dwell: {_OTHER_SCAN}"
_BY_ROW_TIME = f"the calibration again with half or twice the row time: {_OTHER_SCAN}"
_BY_PIXEL_SIZE = f"the calibration again at another magnification, and with another dwell: {_OTHER_SCAN}"


def _settling(
    name: str, description: str, field: Field, parameter: NonlinearParameter, constants: tuple[float, ...], experiment: str
) -> EffectClass:
    return EffectClass(
        name,
        description,
        field,
        values_grid(parameter.name, constants),
        nonlinear_parameters=(parameter,),
        group="G4",
        discriminating_experiment=experiment,
        sizes_px=(0.003, 10.0),
    )


_LENGTH = NonlinearParameter("length_px", "px", 1.58, ratio=True)
FLYBACK_SETTLING = _settling(
    "flyback_settling",
    "rows begin before the beam has settled",
    _row_settling(_row_in_time, "settling_s"),
    NonlinearParameter("settling_s", "s", 1.62, ratio=True),
    FLYBACK_SETTLING_S,
    _BY_TIME,
)
FRAME_START_SETTLING = _settling(
    "frame_start_settling",
    "frames begin before the beam has settled",
    _frame_settling(_frame_in_time, "settling_s"),
    NonlinearParameter("settling_s", "s", 1.67, ratio=True),
    FRAME_START_SETTLING_S,
    _BY_ROW_TIME,
)
ROW_START_SETTLING_IN_POSITION = _settling(
    "row_start_settling_in_position",
    "the start of rows is displaced over a length on the specimen, whatever the dwell",
    _row_settling(_row_in_position, "length_px"),
    _LENGTH,
    LENGTHS_PX,
    _BY_PIXEL_SIZE,
)
FRAME_START_SETTLING_IN_POSITION = _settling(
    "frame_start_settling_in_position",
    "the start of frames is displaced over a length on the specimen, whatever the row time",
    _frame_settling(_frame_in_position, "length_px"),
    _LENGTH,
    LENGTHS_PX,
    _BY_PIXEL_SIZE,
)


def with_two_terms(single: EffectClass) -> EffectClass:
    """The sum of two exponentials of one law; parameters of the second, longer one begin with ``second_``."""
    (parameter,) = single.nonlinear_parameters

    def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
        terms = [single.basis_field(scene, {parameter.name: values[name]}) for name in (parameter.name, SECOND + parameter.name)]
        assert terms[0] is not None  # a decay is observable in every run
        assert terms[1] is not None
        first, second = terms[0], terms[1]
        none = np.zeros(first.field_px.shape[-1])
        reported = (
            *(replace(value, row=np.concatenate((value.row, none))) for value in first.reported_parameters),
            *(replace(value, name=SECOND + value.name, row=np.concatenate((none, value.row))) for value in second.reported_parameters),
        )
        return BasisField(np.concatenate((first.field_px, second.field_px), axis=-1), reported)

    def grid(scene: RunGeometry) -> Iterable[Values]:
        each = [values[parameter.name] for values in single.grid(scene)][::2]
        return ({parameter.name: short, SECOND + parameter.name: long} for short, long in combinations(each, 2) if long > MIN_RATIO * short)

    return replace(
        single,
        name=single.name + TWO_TERMS,
        description=f"{single.description}: the sum of two exponentials",
        basis_field=basis_field,
        grid=grid,
        nonlinear_parameters=(parameter, replace(parameter, name=SECOND + parameter.name)),
    )


SETTLING_CLASSES = (FLYBACK_SETTLING, ROW_START_SETTLING_IN_POSITION, FRAME_START_SETTLING, FRAME_START_SETTLING_IN_POSITION)
"""Laws of settling with one exponential."""
TWO_TERM_CLASSES = {single.name: with_two_terms(single) for single in SETTLING_CLASSES}
"""The same laws with two exponentials, by the name with one."""
