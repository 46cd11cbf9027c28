"""The kernels' door lets nothing in that compiled code would misread."""

import numpy as np
import pytest

from semlive.kernels import arrays, images
from semlive.kernels.subset_matching import icgn, interface

IMAGE = np.random.default_rng(0).normal(0.0, 40.0, (40, 50)).astype(np.float32)
GRID = {"x0_px": 10, "y0_px": 10, "step_px": 5, "shape": (3, 4), "half_px": 5}


@pytest.mark.parametrize(
    ("array", "message"),
    [
        ([1, 2], "an array, not list"),
        (np.zeros((2, 3)), "float32, not float64"),
        (np.zeros(6, np.float32), r"shape \(2, 'any'\), not \(6,\)"),
        (np.zeros((3, 2), np.float32), r"not \(3, 2\)"),
        (np.zeros((3, 2), np.float32).T, "C-contiguous"),
    ],
)
def test_checked_names_what_is_wrong(array, message):
    with pytest.raises(ValueError, match="^thing must .*" + message):
        arrays.checked(array, "thing", np.float32, (2, None))


def test_checked_returns_the_very_array():
    array = np.zeros((2, 3), np.float32)
    assert arrays.checked(array, "thing", np.float32, (2, 3)) is array


@pytest.mark.parametrize(
    "image",
    [np.zeros((9, 9)), np.zeros((9, 9), np.int16), np.zeros((9, 9, 3), np.uint8), np.zeros((3, 99), np.uint8), [[1, 2], [3, 4]], None],
)
def test_grey_takes_8_and_16_bit_images_only(image):
    with pytest.raises(ValueError, match=r"^image must be"):
        images.to_float32_grey(image)


def test_grey_of_any_layout_is_contiguous_and_centred():
    image = np.arange(4000, dtype=np.uint16).reshape(40, 100)[::2, ::3]
    grey = images.to_float32_grey(image)
    assert grey.flags.c_contiguous
    assert grey.dtype == np.float32
    assert abs(float(grey.mean())) < 1e-2
    assert np.allclose(grey - grey[0, 0], image.astype(float) - float(image[0, 0]), atol=1e-3)


def test_functions_refuse_wrong_images():
    wrong = IMAGE.astype(np.float64)
    for call in (images.coefficients, images.interpolator, images.gradients, images.spline_line_derivative):
        with pytest.raises(ValueError, match="float32, not float64"):
            call(wrong)
    with pytest.raises(ValueError, match="at least 4 px"):
        images.coefficients(IMAGE[:2])
    with pytest.raises(ValueError, match="at least 4 samples"):
        images.spline_line_derivative(np.zeros((5, 3), np.float32))


@pytest.mark.parametrize("change", [{"x0_px": 4}, {"y0_px": 4}, {"shape": (3, 9)}, {"shape": (6, 4)}, {"half_px": 11}, {"step_px": 0}])
def test_subsets_must_lie_in_the_image(change):
    with pytest.raises(ValueError, match="are outside the 50 x 40 px image"):
        interface.subset_sums(IMAGE, IMAGE, IMAGE, **{**GRID, **change})


def test_gradients_must_have_the_images_shape():
    with pytest.raises(ValueError, match="gradient_y must have shape"):
        interface.subset_sums(IMAGE, IMAGE, IMAGE[:30], **GRID)


def test_sums_are_read_only_so_that_kernels_are_compiled_once():
    sums = interface.subset_sums(IMAGE, **GRID)
    values = [value for name in sums.__slots__ if isinstance(value := getattr(sums, name), np.ndarray)]
    assert len(values) == 12
    assert not any(value.flags.writeable for value in values)


def solutions():
    return interface.Solutions(np.zeros((3, 4, 6)), np.zeros((3, 4)), np.zeros((3, 4), np.uint8), np.zeros((3, 4), np.int32))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("current", np.zeros((44, 61), np.float32)),
        ("todo", np.zeros((3, 4), np.int64)),
        ("todo", np.zeros((4, 3), np.uint8)),
        ("seeds", np.zeros((3, 4, 2))),
        ("seeds", np.zeros((3, 4, 12))[:, :, ::2]),
    ],
)
def test_correlate_checks_every_array(name, value):
    sums = interface.subset_sums(IMAGE, *images.gradients(IMAGE), **GRID)
    arguments = {"current": images.interpolator(IMAGE), "todo": np.full((3, 4), icgn.SEEDED, np.uint8), "seeds": np.zeros((3, 4, 6))}
    numbers = {"max_iterations": 9, "tolerance_px": 1e-3, "min_zncc": 0.5, "max_travel_px": 5.0}
    out = solutions()
    interface.correlate(sums, **arguments, solutions=out, **numbers)
    assert np.all(out.status == icgn.CONVERGED)
    with pytest.raises(ValueError, match=f"^{name} must"):
        interface.correlate(sums, **{**arguments, name: value}, solutions=solutions(), **numbers)
