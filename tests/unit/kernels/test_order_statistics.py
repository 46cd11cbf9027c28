"""What replaces NumPy's and SciPy's own for few values gives the same to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from semlive.kernels import images
from semlive.kernels.motion_clusters import SIGMAS, cluster_sizes
from semlive.kernels.order_statistics import median_of, percentiles_of, ptp_columns


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_medians_and_percentiles_are_numpys(dtype):
    rng = np.random.default_rng(3)
    for size in (*range(1, 40), 997, 998, 999, 1000):
        for values in (rng.standard_normal(size), rng.integers(0, 4, size)):
            values = values.astype(dtype)
            assert median_of(values) == np.median(values)
            assert median_of(values).dtype == dtype
            assert percentiles_of(values, 10, 35) == np.percentile(values, (10, 35)).tolist()


@pytest.mark.parametrize("shape", [(4, 4), (5, 4), (4, 7), (60, 71), (61, 70)])
@pytest.mark.parametrize("step", [1, 2, 3])
def test_median_of_the_stencil_is_numpys(shape, step):
    rng = np.random.default_rng(4)
    for image in (rng.standard_normal(shape), rng.integers(0, 3, shape), 1e6 * rng.standard_normal(shape), np.zeros(shape)):
        image = image.astype(np.float32)
        lines = np.stack([image[k : k + 3] for k in range(0, shape[0] - 2, step)])
        across = lines[:, 0] - np.float32(2.0) * lines[:, 1] + lines[:, 2]
        amount = np.abs(across[:, :-2] - np.float32(2.0) * across[:, 1:-1] + across[:, 2:])
        expected = np.median(amount[amount > 0.0]) if amount.any() else 0.0
        assert images.median_stencil(image, step) == expected


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("masked", [False, True])
def test_gradient_products_are_those_of_complete_images(axis, masked):
    rng = np.random.default_rng(5)
    image = rng.standard_normal((45, 38)).astype(np.float32)
    usable = (rng.random(image.shape) > 0.2).astype(np.float32) if masked else None
    sobel = images.gradients(image)[0 if axis else 1] * (1.0 if usable is None else usable)
    lines = np.ascontiguousarray(image if axis else image.T)[1:-1]
    spline = images.spline_line_derivative(np.ascontiguousarray(lines))
    inner = (sobel if axis else sobel.T)[1:-1, 1:-1]
    for step in (1, 3):
        overlap, energy = images.gradient_products(image, step, axis, usable)
        assert overlap == pytest.approx(np.mean(inner[::step] * spline[::step], dtype=np.float64), rel=1e-5)
        assert energy == pytest.approx(np.mean(inner[::step] ** 2, dtype=np.float64), rel=1e-5)


def test_grey_levels_of_a_frame_that_is_read_only_or_a_part_are_the_same():
    frame = np.random.default_rng(6).integers(0, 65536, (50, 60)).astype(np.uint16)
    part = frame[3:40, 5:50]
    expected = part.astype(np.float32) - np.float32(part.mean())
    whole = part.copy()
    whole.setflags(write=False)
    for image in (part, part.copy(), whole):
        assert np.array_equal(images.to_float32_grey(image), expected)
    mine = part.copy()
    images.to_float32_grey(mine)
    assert mine.flags.writeable


def test_extent_is_the_range_of_columns():
    values = np.random.default_rng(7).standard_normal((30, 4)).astype(np.float32)
    assert np.array_equal(ptp_columns(values), np.ptp(values, axis=0))
    values[5, 2] = np.nan
    assert np.isnan(ptp_columns(values)).tolist() == [False, False, True, False]


def test_company_is_the_size_of_connected_groups():
    rng = np.random.default_rng(8)
    for shape in ((1, 1), (1, 9), (9, 1), (40, 37)):
        u, v, sigma = rng.standard_normal(shape), rng.standard_normal(shape), 0.1 * rng.random(shape)
        gradient = (0.1 * rng.standard_normal((*shape, 4))).astype(np.float32)
        selected = rng.random(shape) > 0.2
        linked = np.zeros((2 * shape[0] - 1, 2 * shape[1] - 1), dtype=bool)
        linked[::2, ::2] = selected
        for axis, here, there, place in (
            (0, np.s_[:, :-1], np.s_[:, 1:], np.s_[::2, 1::2]),
            (1, np.s_[:-1], np.s_[1:], np.s_[1::2, ::2]),
        ):
            brute_force = [
                np.abs(value[there] - value[here] - np.float32(2.5) * (gradient[here][..., k] + gradient[there][..., k]))
                for value, k in ((u, axis), (v, 2 + axis))
            ]
            linked[place] = selected[here] & selected[there] & (np.maximum(*brute_force) <= 1.5 + SIGMAS * sigma[here])
        label = np.zeros(linked.shape, dtype=np.int32)
        ndimage.label(linked, output=label)
        label = label[::2, ::2]
        expected = np.where(selected, np.bincount(label.ravel())[label], 0)
        assert np.array_equal(cluster_sizes(u, v, gradient, sigma, selected, 2.5, 1.5), expected)
