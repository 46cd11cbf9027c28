"""Quintic splines, second-order subsets and masks against scipy's splines and a general equation solver."""

import numpy as np
import pytest
from scipy import ndimage, optimize

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.data.settings import DicSettings
from semlive.dic.uncertainty import interpolation_noise_gain
from semlive.kernels import images
from semlive.kernels.subset_matching import interface, warp
from semlive.kernels.subset_matching.icgn import SEEDED

HALF = 15
ORDER = {"cubic": 3, "quintic": 5}
CASES = [
    ("quintic", "affine", False),
    ("cubic", "quadratic", False),
    ("quintic", "quadratic", False),
    ("cubic", "affine", True),
    ("quintic", "quadratic", True),
    ("cubic", "quartic", False),
    ("quintic", "quartic", True),
]
TERMS = {"affine": 3, "quadratic": 6, "quartic": 15}  # of u, as many of v


@pytest.mark.parametrize("shape", [(64, 81), (6, 200), (200, 6), (4, 4)])
def test_quintic_prefilter_is_scipys(shape):
    image = np.random.default_rng(1).uniform(-120.0, 120.0, shape).astype(np.float32)
    expected = ndimage.spline_filter(image.astype(np.float64), order=5, mode="mirror")
    assert np.max(np.abs(images.coefficients(image, 5) - expected)) < 2e-3  # coefficients reach 5000


def test_quintic_interpolator_is_mirrored_about_the_outer_samples():
    image = np.random.default_rng(3).uniform(-1.0, 1.0, (30, 40)).astype(np.float32)
    c = images.interpolator(image, 5)
    expected = np.pad(images.coefficients(image, 5), 3, mode="reflect")
    assert np.array_equal(c[:, :46], expected)
    assert not c[:, 46:].any()


def test_noise_passed_by_the_quintic_spline_is_what_noise_shows():
    noise = np.random.default_rng(6).standard_normal(400_000)
    zero = np.zeros(1)
    for phase in (0.0, 0.2, 0.5, 0.9):
        shifted = ndimage.shift(noise, phase, order=5, mode="mirror")
        assert interpolation_noise_gain(np.array([phase]), zero, zero, 43, "quintic")[0] == pytest.approx(np.var(shifted), rel=0.01)


def bent_pair():
    """A 16 bit texture and a second frame: shifted, strained, bent, brighter, with noise."""
    rng = np.random.default_rng(5)
    texture = ndimage.gaussian_filter(rng.standard_normal((110, 140)), 2.0)
    texture *= 40.0 / texture.std()
    y, x = np.mgrid[0:110, 0:140].astype(float)
    dx, dy = x - 70.0, y - 55.0
    there = [y - 1.7 - 2e-3 * dx + 1e-4 * dx * dy, x + 2.4 - 4e-3 * dx + 1e-3 * dy + 3e-4 * dx * dx]
    second = 1.1 * ndimage.map_coordinates(texture, there, order=5, mode="mirror") + 9.0
    return [
        np.clip(np.round(100.0 * (200.0 + a + 2.0 * rng.standard_normal(a.shape))), 0, 65535).astype(np.uint16) for a in (texture, second)
    ]


def holes():
    mask = np.ones((110, 140), dtype=bool)
    mask[40:52, 60:75] = False
    mask[:, :38] = False
    mask[80, 90] = False
    return mask


def solved(interpolation, shape_function, masked):
    first, second = bent_pair()
    mask = holes()
    if masked:
        first[~mask] = 0  # what the mask hides must not matter
    settings = DicSettings(
        subset_px=2 * HALF + 1,
        step_px=9,
        roi_px=(30, 30, 100, 70),
        tolerance_px=1e-5,
        interpolation=interpolation,
        shape_function=shape_function,
    )
    grid = dic.grid_for(settings, 140, 110)
    reference = dic.prepare(first, grid, settings, mask if masked else None)
    shape = grid.shape
    solutions = interface.Solutions(
        np.zeros((*shape, 6)), np.zeros(shape), np.zeros(shape, np.uint8), np.zeros(shape, np.int32), np.zeros((*shape, 6))
    )
    x, _ = grid.mesh()
    seeds = np.zeros((*shape, 6))
    seeds[..., 0], seeds[..., 3] = -2.4 + 4e-3 * (x - 70), 1.7 + 2e-3 * (x - 70)
    interface.correlate(
        reference.sums, images.interpolator(images.to_float32_grey(second), ORDER[interpolation]), np.full(shape, SEEDED, np.uint8),
        seeds, solutions,
        max_iterations=50, tolerance_px=1e-5, min_zncc=0.5, max_travel_px=4.0, order=ORDER[interpolation],
    )  # fmt: skip
    if shape_function == "quartic":
        current = images.interpolator(images.to_float32_grey(second), ORDER[interpolation])
        interface.refine(reference.sums, current, solutions, max_iterations=50, tolerance_px=5e-5, min_zncc=0.5, order=ORDER[interpolation])
    return first.astype(float), second.astype(float), mask, grid, reference, solutions


def monomials(dx, dy):
    """Derivatives of u with respect to its coefficients, those of third and fourth order in units of half the subset."""
    second = [np.ones_like(dx), dx, dy, dx * dx / 2.0, dx * dy, dy * dy / 2.0]
    return second + [dx ** (n - k) * dy**k / HALF**n for n in (3, 4) for k in range(n + 1)]


def check_covariance(sums, at, inverse, used):
    assert sums.variance_u[at] == pytest.approx(inverse[0, 0], rel=1e-3)
    assert sums.variance_v[at] == pytest.approx(inverse[used, used], rel=1e-3)
    assert sums.covariance[at] == pytest.approx(inverse[0, used], abs=1e-3 * inverse[0, 0])


@pytest.mark.parametrize(("interpolation", "shape_function", "masked"), CASES)
def test_solution_solves_its_equations(interpolation, shape_function, masked):
    """ZNSSD's estimating equations, written down plainly in float64, have their root where IC-GN ended."""
    first, second, mask, grid, reference, solutions = solved(interpolation, shape_function, masked)
    order = ORDER[interpolation]
    spline = ndimage.spline_filter(second, order=order, mode="mirror")
    # half of the subset at (1, 1) is masked: fifteen terms each cannot be determined there
    for i, j in [(6, 2) if masked and shape_function == "quartic" else (1, 1), (3, 2), (7, 4)]:
        assert solutions.status[j, i] == PoiStatus.CONVERGED
        dy, dx = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1].astype(float)
        x, y = int(grid.x_px[i]), int(grid.y_px[j])
        here = np.s_[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1]
        counts = np.ones(dx.shape, dtype=bool)
        if masked:
            hidden = ndimage.maximum_filter((~mask).astype(np.uint8), size=3)
            counts = hidden[here] == 0
            assert reference.sums.pixels[j, i] == counts.sum()
        gx, gy = (ndimage.sobel(first, axis=axis)[here] / 8.0 for axis in (1, 0))
        powers = monomials(dx, dy)
        used = TERMS[shape_function]
        derivatives = np.stack([g * power for g in (gx, gy) for power in powers[:used]])[:, counts]
        f = first[here][counts]

        def deformed(p, x=x, y=y, dx=dx, dy=dy, counts=counts, powers=powers, used=used):
            u, v = (sum(c * power for c, power in zip(q, powers, strict=False)) for q in (p[:used], p[used:]))
            at = [y + dy + v, x + dx + u]
            return ndimage.map_coordinates(spline, at, order=order, mode="mirror", prefilter=False)[counts]

        def normalised(values):
            return (values - values.mean()) / np.linalg.norm(values - values.mean())

        lever = np.tile([1.0, HALF, HALF, HALF**2, HALF**2, HALF**2, *[1.0] * 9][:used], 2)

        def equations(q, f=f, derivatives=derivatives, deformed=deformed, lever=lever):
            residual = normalised(f) - normalised(deformed(q / lever))
            return derivatives @ residual / lever

        assert solutions.curvatures is not None
        p, bend = solutions.parameters[j, i], solutions.curvatures[j, i]
        ours = np.concatenate([p[:3], p[3:]] if used == 3 else [p[:3], bend[:3], p[3:], bend[3:]])
        columns = np.concatenate([np.arange(min(used, 6)), used + np.arange(min(used, 6))])
        ours *= lever[columns]
        start = np.bincount(columns, np.round(ours, 1), 2 * used)
        found = optimize.root(equations, start, method="hybr", tol=1e-12)
        assert np.max(np.abs(equations(found.x))) < 1e-9 * np.linalg.norm(derivatives[0])
        assert np.max(np.abs(found.x[columns] - ours)) < 4e-5
        zncc = np.sum(normalised(f) * normalised(deformed(found.x / lever)))
        assert solutions.zncc[j, i] == pytest.approx(zncc, abs=1e-6)
        # the factored matrix is the plain one (Sobel scaled by one gain each way)
        matrix = reference.sums.lower[j, i]
        lower = np.tril(matrix) @ np.tril(matrix).T
        gains = reference.sums.gradient_x[y, x] / gx[HALF, HALF], reference.sums.gradient_y[y, x] / gy[HALF, HALF]
        scaled = derivatives * np.repeat(gains, used)[:, None]
        expected = scaled @ scaled.T
        check_covariance(reference.sums, (j, i), np.linalg.inv(expected), used)
        if used == 15:
            continue  # its matrix is not kept
        layout = [0, 1, 2, 3, 4, 5] if used == 3 else [0, 1, 2, 6, 7, 8, 3, 4, 5, 9, 10, 11]
        diagonal = np.sqrt(np.diag(expected))
        difference = (lower[np.ix_(layout, layout)] - expected) / np.outer(diagonal, diagonal)
        assert np.max(np.abs(difference)) < 1e-5


def warped(p, dx, dy):
    """Position after a warp of second order, written down plainly."""
    powers = [np.ones_like(dx), dx, dy]
    bends = [dx * dx / 2.0, dx * dy, dy * dy / 2.0]
    u, v = (sum(c * b for c, b in zip([*p[at : at + 3], *p[6 + at : 9 + at]], powers + bends, strict=True)) for at in (0, 3))
    return dx + u, dy + v


def test_composition_undoes_a_small_warp_first():
    rng = np.random.default_rng(8)
    scale = np.array([1.0, 0.05, 0.05] * 2 + [1e-3] * 6)
    p, d = rng.normal(0.0, 1.0, 12) * scale, 0.01 * rng.normal(0.0, 1.0, 12) * scale
    q = p.copy()
    warp.compose_inverse(q, d, 12)
    dx, dy = np.meshgrid(np.linspace(-15, 15, 7), np.linspace(-15, 15, 7))
    # W(q) after W(d) is W(p), but for third order
    for got, want in zip(warped(q, *warped(d, dx, dy)), warped(p, dx, dy), strict=True):
        assert np.max(np.abs(got - want)) < 2e-4
    affine = p.copy()
    affine[6:] = 0.0
    small = d.copy()
    small[6:] = 0.0
    by_six, by_twelve = affine.copy(), affine.copy()
    warp.compose_inverse(by_six, small, 6)
    warp.compose_inverse(by_twelve, small, 12)
    assert np.max(np.abs(by_six - by_twelve)) < 1e-12


def test_a_bent_field_is_followed_by_second_order_and_not_by_affine(lab_speckle):
    first, second, truth = lab_speckle
    errors = {}
    for shape_function in ("affine", "quadratic"):
        settings = DicSettings(subset_px=31, step_px=12, roi_px=(30, 30, 130, 100), shape_function=shape_function)
        grid = dic.grid_for(settings, 160, 130)
        m = dic.correlate(dic.prepare(first, grid, settings), second, settings, reference_frame=0, current_frame=1)
        assert m.valid.all()
        errors[shape_function] = np.mean(m.u_px - truth(*grid.mesh()))
    assert abs(errors["quadratic"]) < 1e-3
    assert abs(errors["affine"]) > 5e-3


@pytest.fixture(scope="module")
def lab_speckle():
    rng = np.random.default_rng(9)
    spots = rng.uniform(-20, [180, 150], (2400, 2))
    sign = rng.choice([-1.0, 1.0], 2400)

    def truth(x, y):
        return 3e-4 * (x - 80.0) ** 2

    def image(u):
        y, x = np.mgrid[0:130, 0:160].astype(float)
        at = x.copy()
        for _ in range(20):
            at = x - u(at, y)  # position in the reference
        grey = np.zeros(x.shape)
        for (sx, sy), s in zip(spots, sign, strict=True):
            near = np.s_[max(int(sy) - 11, 0) : max(int(sy) + 12, 0), :]
            grey[near] += s * np.exp(-((at[near] - sx) ** 2 + (y[near] - sy) ** 2) / 8.0)
        return np.round(100.0 * (300.0 + 30.0 * grey)).astype(np.uint16)

    return image(lambda x, y: 0.0 * x), image(truth), truth
