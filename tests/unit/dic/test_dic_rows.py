"""Row registration against images in which every row was displaced by a known amount."""

import dataclasses

import numpy as np
import pytest

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.dic.row_registration import gradient_scales, register_rows, row_jitter, smoothed_gradients
from semlive.errors import BadInput
from semlive.kernels import images
from semlive.kernels import row_registration as kernel

WIDTH, HEIGHT = 480, 320
SETTINGS = DicSettings(subset_px=43, step_px=10, roi_px=None)


@dataclasses.dataclass(frozen=True, eq=False)
class RowMotion:
    """Strain and shift, and every row of the frame displaced by its own amount."""

    row_u: np.ndarray
    row_v: np.ndarray
    u: float = 0.0
    v: float = 0.0
    ux: float = 0.0

    def at(self, x, y):
        return self.u + self.ux * x, np.full_like(y, self.v)

    def back(self, x, y):
        row = np.rint(y).astype(int)
        return (x - self.u - self.row_u[row]) / (1.0 + self.ux), y - self.v - self.row_v[row]


@pytest.fixture(scope="module")
def specimen(lab):
    return lab.Speckle(WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def scenes(specimen):
    """Pairs of frames without noise and what their rows did: u and v of the current frame minus the reference."""
    rng = np.random.default_rng(7)
    still = np.zeros(HEIGHT)
    a, b, c = (0.03 * rng.standard_normal(HEIGHT) for _ in range(3))
    hum = 0.02 * np.sin(2.0 * np.pi * 50.0 * 0.1071 * np.arange(HEIGHT) + 0.4)
    big = 0.4 * rng.standard_normal(HEIGHT)
    pairs = {
        "jitter": (RowMotion(a, still), RowMotion(b, c, u=0.4, ux=1e-3)),
        "drifted": (RowMotion(a, still), RowMotion(b, still, u=3.3, v=-2.5)),
        "hum": (RowMotion(still, still), RowMotion(hum, still, u=0.3)),
        "big": (RowMotion(still, still), RowMotion(big, still)),
    }
    return {
        name: (specimen.render(first), specimen.render(second), second.row_u - first.row_u, second.row_v - first.row_v)
        for name, (first, second) in pairs.items()
    }


def registered(lab, scene, noise, seed=0, **options):
    first, second = (lab.expose(image, noise, 2 * seed + k) for k, image in enumerate(scene[:2]))
    grid = dic.grid_for(SETTINGS, WIDTH, HEIGHT)
    disparity = dic.correlate(dic.prepare(first, grid, SETTINGS), second, SETTINGS, reference_frame=4, current_frame=5)
    return register_rows(first, second, disparity, **options)


def test_without_noise_rows_are_found_as_they_are(lab, scenes):
    shifts = registered(lab, scenes["jitter"], 0.0)
    assert shifts.valid.all()
    assert (shifts.reference, shifts.current) == (4, 5)
    assert np.array_equal(shifts.row_px, np.arange(3, HEIGHT - 3))
    for found, truth in zip((shifts.u_px, shifts.v_px), scenes["jitter"][2:], strict=True):
        # The mean over a subset's rows is in the smooth map already, and the map is extrapolated at the frame's edge.
        beyond = truth[shifts.row_px][43:-43] - np.convolve(truth[shifts.row_px], np.ones(43) / 43.0, mode="same")[43:-43]
        assert np.std(found[43:-43] - beyond) < 4e-3
        assert np.polyfit(beyond, found[43:-43], 1)[0] == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("noise", [5.1, 12.75, 25.5])
def test_amplitude_survives_noise_and_noise_is_stated(lab, scenes, noise):
    shifts = registered(lab, scenes["jitter"], noise)
    assert shifts.valid.all()
    assert shifts.noise_grey == pytest.approx(noise, rel=0.05)
    row = shifts.row_px
    for found, sigma, truth in zip(
        (shifts.u_px, shifts.v_px), (shifts.sigma_u_px, shifts.sigma_v_px), (t[row] for t in scenes["jitter"][2:]), strict=True
    ):
        error = found - truth
        assert np.std(error) == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=0.12)  # 314 rows know it to 4 %
        floor = np.sqrt(2.0) * noise / np.sqrt(170.0 * (WIDTH - 6))  # of 170 mean squared gradient
        assert np.std(error) < 1.2 * floor
    error = shifts.segment_u_px - scenes["jitter"][2][row][:, None]
    assert np.std(error) == pytest.approx(np.sqrt(np.mean(shifts.segment_sigma_u_px**2)), rel=0.12)


@pytest.mark.parametrize(("noise", "tolerance"), [(5.1, 0.1), (12.75, 0.15)])
@pytest.mark.parametrize("scene", ["jitter", "drifted"])
def test_jitter_is_found_as_such(lab, scenes, scene, noise, tolerance):
    # Several draws of noise over one draw of jitter, whose own standard deviation over 640 rows is known to 3 %.
    found = [row_jitter(registered(lab, scenes[scene], noise, seed)).sd_u_px for seed in range(6)]
    assert np.mean(found) == pytest.approx(0.030, rel=tolerance)


def test_hum_of_0_02_px_is_detected(lab, scenes):
    shifts = registered(lab, scenes["hum"], 5.1)
    wave = np.exp(2j * np.pi * 50.0 * 0.1071 * shifts.row_px)
    amplitude = 2.0 * abs(np.mean(shifts.u_px * wave))
    sigma = np.sqrt(np.mean(shifts.sigma_u_px**2)) * np.sqrt(2.0 / shifts.row_px.size)
    assert amplitude == pytest.approx(0.02, abs=3.5 * sigma)
    assert amplitude > 7.0 * sigma


def test_large_jitter_is_linearised_twice(lab, scenes):
    shifts = registered(lab, scenes["big"], 2.0)
    truth = scenes["big"][2][shifts.row_px]
    assert np.std(truth) > 0.35
    assert np.polyfit(truth, shifts.u_px, 1)[0] == pytest.approx(1.0, abs=0.05)


def test_saturated_and_masked_rows_are_not_registered(lab, scenes):
    first, second = (lab.expose(image, 2.0, k) for k, image in enumerate(scenes["hum"][:2]))
    first[100:104] = 255
    mask = np.ones(first.shape, dtype=bool)
    mask[200:210] = False
    mask[:, 300:] = False
    grid = dic.grid_for(SETTINGS, WIDTH, HEIGHT)
    disparity = dic.correlate(dic.prepare(first, grid, SETTINGS), second, SETTINGS, reference_frame=0, current_frame=1)
    shifts = register_rows(first, second, disparity, segments=4, mask=mask)
    lost = np.isin(shifts.row_px, [*range(100, 104), *range(200, 210)])
    assert np.array_equal(shifts.valid, ~lost)
    assert np.array_equal(shifts.segment_valid[~lost], np.tile([True, True, True, False], (np.sum(~lost), 1)))
    assert not shifts.u_px[lost].any()
    assert not shifts.sigma_u_px[lost].any()


def test_scales_make_instruments_true_derivatives(lab, scenes):
    exact = scenes["hum"][0]
    true_x, true_y = np.gradient(exact, axis=1), np.gradient(exact, axis=0)
    for noise in (0.0, 25.0):
        noisy = images.to_float32_grey(lab.expose(exact, noise, 9))
        along_x, along_y = smoothed_gradients(noisy)
        scale_x, scale_y = gradient_scales(noisy, along_x, along_y, float(np.hypot(noise, 12**-0.5)))
        inner = np.s_[5:-5, 5:-5]
        # Central differences of exact images: 4 % short of the derivative of speckle of this size, as their own smoothing predicts.
        for instrument, scale, true in ((along_x, scale_x, true_x), (along_y, scale_y, true_y)):
            best = np.vdot(instrument[inner], true[inner]) / np.vdot(instrument[inner], instrument[inner])
            assert scale == pytest.approx(best, rel=0.06)


def test_kernel_sums_are_the_plain_sums(lab, scenes):
    f, g = (images.to_float32_grey(lab.expose(image)) for image in scenes["hum"][:2])
    along_x, along_y = smoothed_gradients(f)
    edges = np.array([3, 200, 477])
    nodes = np.zeros((1, 1), dtype=np.float32)
    zero = np.zeros(HEIGHT)
    sums = kernel.sum_rows(
        f, along_x, along_y, images.coefficients(g), np.ones(f.shape, dtype=bool), edges, (nodes, nodes),
        (np.array([5.0, 0.0, 0.0]), np.array([-2.0, 0.0, 0.0])), (0, 0, 1), (zero, zero), 1.5,
    )  # fmt: skip
    row, part = 50, slice(3, 200)
    d = 1.5 * g[row - 2, 8:205].astype(float) - f[row, part]
    gx, gy = along_x[row, part].astype(float), along_y[row, part].astype(float)
    expected = [197, gx.sum(), gy.sum(), d.sum(), gx @ gx, gx @ gy, gy @ gy, gx @ d, gy @ d, d @ d, -2.0 * 197]
    assert np.allclose(sums[row, 0], expected, rtol=1e-4, atol=0.5)
    assert not sums[:3].any()


def test_result_does_not_depend_on_threads(lab, scenes, monkeypatch):
    first = registered(lab, scenes["hum"], 5.0)
    monkeypatch.setattr("semlive.kernels.threads.thread_count", lambda: 1)
    second = registered(lab, scenes["hum"], 5.0)
    assert np.array_equal(first.u_px, second.u_px)


def test_bad_input_gives_one_error_line(lab, scenes):
    first, second = (lab.expose(image) for image in scenes["hum"][:2])
    grid = dic.grid_for(SETTINGS, WIDTH, HEIGHT)
    disparity = dic.correlate(dic.prepare(first, grid, SETTINGS), second, SETTINGS, reference_frame=0, current_frame=1)
    with pytest.raises(BadInput, match="480 x 320 px but the current frame 480 x 300 px"):
        register_rows(first, second[:300], disparity)
    with pytest.raises(BadInput, match="1 to 11 segments"):
        register_rows(first, second, disparity, segments=12)
    with pytest.raises(BadInput, match="the mask is 10 x 10 px"):
        register_rows(first, second, disparity, mask=np.ones((10, 10), dtype=bool))
    lost = dataclasses.replace(disparity, status=np.full_like(disparity.status, 1))
    with pytest.raises(BadInput, match="fewer than three points"):
        register_rows(first, second, lost)
