"""The DIC kernels against slow and independent answers: scipy's splines, brute sums, a general equation solver."""

import numpy as np
import pytest
from scipy import ndimage, optimize

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.data.settings import DicSettings
from semlive.dic.correlate import solve
from semlive.dic.initial_guess.search import match
from semlive.dic.uncertainty import interpolation_noise_gain
from semlive.kernels import images
from semlive.kernels.subset_matching import interface
from semlive.kernels.subset_matching.icgn import SEEDED

HALF = 15
SETTINGS = DicSettings(subset_px=2 * HALF + 1, step_px=9, roi_px=(30, 30, 100, 70), tolerance_px=1e-6)


@pytest.mark.parametrize("shape", [(64, 81), (5, 200), (200, 5), (4, 4)])
def test_prefilter_is_scipys(shape):
    image = np.random.default_rng(1).uniform(-120.0, 120.0, shape).astype(np.float32)
    expected = ndimage.spline_filter(image.astype(np.float64), order=3, mode="mirror")
    assert np.max(np.abs(images.coefficients(image) - expected)) < 2e-4


def test_coefficients_interpolate_the_samples():
    image = np.random.default_rng(2).uniform(-120.0, 120.0, (50, 40)).astype(np.float32)
    c = np.pad(images.coefficients(image).astype(np.float64), 1, mode="reflect")
    rows = (c[:-2] + 4.0 * c[1:-1] + c[2:]) / 6.0
    assert np.max(np.abs((rows[:, :-2] + 4.0 * rows[:, 1:-1] + rows[:, 2:]) / 6.0 - image)) < 1e-4


def test_interpolator_is_mirrored_about_the_outer_samples():
    image = np.random.default_rng(3).uniform(-1.0, 1.0, (30, 40)).astype(np.float32)
    c = images.interpolator(image)
    assert np.array_equal(c[2:-2, 0], c[2:-2, 4])
    assert np.array_equal(c[2:-2, 2 + 40 + 1], c[2:-2, 2 + 40 - 3])
    assert np.array_equal(c[1], c[3])


def test_line_derivative_is_the_splines():
    lines = np.random.default_rng(4).uniform(-1.0, 1.0, (7, 60)).astype(np.float32)
    h = 1e-4
    x = np.arange(1.0, 59.0)
    for line, derivative in zip(lines, images.spline_line_derivative(lines), strict=True):
        c = ndimage.spline_filter1d(line.astype(np.float64), order=3, mode="mirror")
        ahead, behind = (ndimage.map_coordinates(c, [x + s], order=3, mode="mirror", prefilter=False) for s in (h, -h))
        assert np.max(np.abs((ahead - behind) / (2.0 * h) - derivative)) < 1e-5


def smooth_random_pair(noise):
    """A 16 bit texture and a second frame: shifted, strained, brighter, and with noise of its own."""
    rng = np.random.default_rng(5)
    texture = ndimage.gaussian_filter(rng.standard_normal((110, 140)), 2.0)
    texture *= 40.0 / texture.std()
    y, x = np.mgrid[0:110, 0:140].astype(float)
    there = [y - 1.7 - 2e-3 * (x - 70), x + 2.4 - 4e-3 * (x - 70) + 1e-3 * (y - 55)]
    second = 1.1 * ndimage.map_coordinates(texture, there, order=5, mode="mirror") + 9.0
    return [
        np.clip(np.round(100.0 * (200.0 + a + noise * rng.standard_normal(a.shape))), 0, 65535).astype(np.uint16) for a in (texture, second)
    ]


def solved_pair(noise):
    first, second = smooth_random_pair(noise)
    grid = dic.grid_for(SETTINGS, 140, 110)
    reference = dic.prepare(first, grid, SETTINGS)
    current = images.to_float32_grey(second)
    solutions = solve(reference, images.interpolator(current), match(reference.coarse, current), SETTINGS)
    assert np.all(solutions.status == PoiStatus.CONVERGED)
    return first.astype(float), second.astype(float), grid, reference, solutions


@pytest.fixture(scope="module")
def solved():
    return solved_pair(noise=3.0)


@pytest.fixture(scope="module")
def solved_low_noise():
    return solved_pair(noise=0.0)


def solved_steep():
    """A pair with 12 % strain and a rotation of 0.15: rows of a subset cross many pixel boundaries both ways."""
    rng = np.random.default_rng(7)
    texture = ndimage.gaussian_filter(rng.standard_normal((110, 140)), 2.0)
    texture *= 40.0 / texture.std()
    p = np.array([0.3, 0.12, -0.15, -0.6, 0.15, -0.08])
    y, x = np.mgrid[0:110, 0:140].astype(float)
    there = np.linalg.solve([[1.0 + p[1], p[2]], [p[4], 1.0 + p[5]]], np.stack([x - 70.0 - p[0], y - 55.0 - p[3]]).reshape(2, -1))
    second = ndimage.map_coordinates(texture, [there[1] + 55.0, there[0] + 70.0], order=5, mode="mirror").reshape(texture.shape)
    first, second = (np.round(100.0 * (200.0 + a)).astype(np.uint16) for a in (texture, second))
    settings = DicSettings(2 * HALF + 1, 1, (70, 55, 70, 55), tolerance_px=1e-6)
    grid = dic.grid_for(settings, 140, 110)
    reference = dic.prepare(first, grid, settings)
    solutions = interface.Solutions(np.zeros((1, 1, 6)), np.zeros((1, 1)), np.zeros((1, 1), np.uint8), np.zeros((1, 1), np.int32))
    interface.correlate(
        reference.sums,
        images.interpolator(images.to_float32_grey(second)),
        np.full((1, 1), SEEDED, np.uint8),
        0.9 * p.reshape(1, 1, 6),
        solutions,
        max_iterations=50,
        tolerance_px=1e-6,
        min_zncc=0.5,
        max_travel_px=3.0,
    )
    assert solutions.status[0, 0] == PoiStatus.CONVERGED
    assert np.max(np.abs(solutions.parameters[0, 0] - p)) < 3e-3
    return first.astype(float), second.astype(float), grid, reference, solutions


def subset_of(first, second, grid, i, j):
    """f, the six Sobel derivatives, and a function p -> g of one POI, written down plainly."""
    dy, dx = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1].astype(float)
    x, y = int(grid.x_px[i]), int(grid.y_px[j])
    here = np.s_[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1]
    gx, gy = (ndimage.sobel(first, axis=axis)[here] / 8.0 for axis in (1, 0))
    derivatives = np.stack([gx, gx * dx, gx * dy, gy, gy * dx, gy * dy])
    spline = ndimage.spline_filter(second, order=3, mode="mirror")

    def deformed(p):
        at = [y + dy + p[3] + p[4] * dx + p[5] * dy, x + dx + p[0] + p[1] * dx + p[2] * dy]
        return ndimage.map_coordinates(spline, at, order=3, mode="mirror", prefilter=False)

    return first[here], derivatives, deformed


def normalised(values):
    centred = values - values.mean()
    return centred / np.linalg.norm(centred)


POI = [(0, 0), (3, 2), (7, 4), (5, 1)]


def assert_solves_its_equations(solved, i, j):
    """ZNSSD's estimating equations, written down plainly in float64, have their root where IC-GN ended."""
    first, second, grid, _, solutions = solved
    f, derivatives, deformed = subset_of(first, second, grid, i, j)
    lever = np.array([1.0, HALF, HALF, 1.0, HALF, HALF])

    def equations(q):
        residual = normalised(f) - normalised(deformed(q / lever))
        return np.sum(derivatives * residual, axis=(1, 2)) / lever

    start = np.round(solutions.parameters[j, i] * lever, 1)
    found = optimize.root(equations, start, method="hybr", tol=1e-12)
    scale = np.linalg.norm(derivatives[0])
    assert np.max(np.abs(equations(found.x))) < 1e-9 * scale
    assert np.max(np.abs(found.x - solutions.parameters[j, i] * lever)) < 2e-5
    zncc = np.sum(normalised(f) * normalised(deformed(found.x / lever)))
    assert solutions.zncc[j, i] == pytest.approx(zncc, abs=1e-6)


@pytest.mark.parametrize(("i", "j"), POI)
def test_solution_solves_its_equations(solved, i, j):
    assert_solves_its_equations(solved, i, j)


def test_solution_solves_its_equations_at_large_deformation():
    assert_solves_its_equations(solved_steep(), 0, 0)


@pytest.mark.parametrize(("i", "j"), POI)
def test_solution_is_the_least_squares_match(solved_low_noise, i, j):
    # Without noise only: with it the least-squares match itself is drawn to half pixels, where interpolation smooths most.
    first, second, grid, _, solutions = solved_low_noise
    f, _, deformed = subset_of(first, second, grid, i, j)
    start = np.round(solutions.parameters[j, i], 2)
    best = optimize.least_squares(lambda p: (normalised(f) - normalised(deformed(p))).ravel(), start, x_scale="jac", xtol=1e-12, ftol=1e-12)
    assert np.max(np.abs(best.x - solutions.parameters[j, i])[[0, 3]]) < 5e-4


@pytest.mark.parametrize(("i", "j"), POI)
def test_reference_sums_are_the_plain_sums(solved, i, j):
    first, second, grid, reference, _ = solved
    f, derivatives, _ = subset_of(first, second, grid, i, j)
    sums = reference.sums
    y, x = int(grid.y_px[j]), int(grid.x_px[i])
    gain_x = sums.gradient_x[y, x] / (ndimage.sobel(first, axis=1)[y, x] / 8.0)
    gain_y = sums.gradient_y[y, x] / (ndimage.sobel(first, axis=0)[y, x] / 8.0)
    derivatives = derivatives * np.repeat([gain_x, gain_y], 3)[:, None, None]
    matrix = np.einsum("kyx,lyx->kl", derivatives, derivatives)
    lower = np.tril(sums.lower[j, i])
    assert np.allclose(lower @ lower.T, matrix, rtol=1e-4, atol=1e-5 * matrix.max())
    assert sums.variance_u[j, i] == pytest.approx(np.linalg.inv(matrix)[0, 0], rel=1e-4)
    assert sums.variance_v[j, i] == pytest.approx(np.linalg.inv(matrix)[3, 3], rel=1e-4)
    assert sums.sssig[j, i] == pytest.approx(np.linalg.eigvalsh(matrix[np.ix_([0, 3], [0, 3])])[0], rel=1e-4)
    assert sums.norm[j, i] == pytest.approx(np.linalg.norm(f - f.mean()), rel=1e-5)
    assert np.allclose(sums.gradient_sum[j, i], derivatives.sum(axis=(1, 2)), atol=1e-4 * np.abs(derivatives).sum(axis=(1, 2)).max())
    expected = np.sum(derivatives * (f - f.mean()), axis=(1, 2))
    assert np.allclose(sums.gradient_image_sum[j, i], expected, atol=1e-5 * np.abs(derivatives * f).sum(axis=(1, 2)).max())


def test_noise_passed_by_interpolation_is_what_noise_shows():
    noise = np.random.default_rng(6).standard_normal(400_000)
    for phase in (0.0, 0.2, 0.5, 0.9):
        shifted = ndimage.shift(noise, phase, order=3, mode="mirror")
        zero = np.zeros(1)
        assert interpolation_noise_gain(np.array([phase]), zero, zero, 43)[0] == pytest.approx(np.var(shifted), rel=0.01)
    # A stretch of one pixel over the subset covers every phase equally.
    everywhere = interpolation_noise_gain(np.array([0.3]), np.array([1.0 / 43.0]), np.zeros(1), 43)[0]
    assert everywhere == pytest.approx(
        np.mean(interpolation_noise_gain(np.linspace(0.0, 1.0, 64, endpoint=False), np.zeros(64), np.zeros(64), 43))
    )


@pytest.mark.parametrize("parameters", [6, 12])
def test_variances_and_covariance_are_those_of_the_inverse_matrix(parameters):
    image = ndimage.gaussian_filter(np.random.default_rng(8).standard_normal((60, 70)), (1.0, 3.0)).astype(np.float32) * 100.0
    image += np.roll(image, (2, 2), axis=(0, 1))  # slanted, so that u and v are correlated
    sums = interface.subset_sums(image, x0_px=15, y0_px=15, step_px=13, shape=(3, 4), half_px=10, parameters=parameters)
    lower = np.tril(sums.lower)
    inverse = np.linalg.inv(lower @ np.swapaxes(lower, -1, -2))
    for name, (i, j) in (("variance_u", (0, 0)), ("variance_v", (3, 3)), ("covariance", (0, 3))):
        assert np.allclose(getattr(sums, name), inverse[..., i, j], rtol=1e-9), name
    assert np.abs(sums.covariance / np.sqrt(sums.variance_u * sums.variance_v)).max() > 0.2


def test_a_map_has_covariance_and_iterations():
    image = (
        (128.0 + 30.0 * ndimage.gaussian_filter(np.random.default_rng(8).standard_normal((90, 90)), 2.0) * 7.0)
        .clip(0, 255)
        .astype(np.uint8)
    )
    settings = DicSettings(subset_px=21, step_px=10, roi_px=None)
    grid = dic.grid_for(settings, 90, 90)
    reference = dic.prepare(image, grid, settings)
    m = dic.correlate(reference, np.roll(image, 1, axis=1), settings, reference_frame=0, current_frame=1)
    assert m.iterations is not None
    assert m.covariance_px2 is not None
    assert np.all(m.iterations[m.valid] >= 1)
    ok = m.valid
    expected = reference.sums.covariance[ok] / np.sqrt(reference.sums.variance_u * reference.sums.variance_v)[ok]
    assert np.allclose(m.covariance_px2[ok] / (m.sigma_u_px * m.sigma_v_px)[ok], expected)
    assert np.all(m.covariance_px2[~m.valid] == 0.0)
