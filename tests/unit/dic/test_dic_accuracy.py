"""What the engine measures, against images whose motion is known exactly."""

import subprocess
import sys

import numpy as np
import pytest

from semlive import dic
from semlive.data.settings import DicSettings

SETTINGS = DicSettings(step_px=12, roi_px=(36, 36, 264, 224))


@pytest.mark.parametrize("shift", [0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875])
def test_sub_pixel_bias_is_below_a_thousandth(lab, scene, measure, shift):
    current = scene(lab.Affine(u=1.0 + shift, v=-2.0 - shift))
    m = measure(lab.expose(scene(), bits=16), lab.expose(current, bits=16), SETTINGS)
    assert m.valid.all()
    assert abs(np.mean(m.u_px) - 1.0 - shift) < 1e-3
    assert abs(np.mean(m.v_px) + 2.0 + shift) < 1e-3
    assert np.std(m.u_px) < 1e-3


def test_strain_and_shear_are_followed(lab, scene, measure):
    motion = lab.Affine(u=3.3, v=-2.7, ux=3e-3, uy=-1e-3, vx=2e-3, vy=-1e-3, xc=150, yc=130)
    m = measure(lab.expose(scene(), bits=16), lab.expose(scene(motion), bits=16), SETTINGS)
    u, v = motion.at(*m.grid.mesh())
    assert m.valid.all()
    assert np.max(np.abs(m.u_px - u)) < 2e-3
    assert np.max(np.abs(m.v_px - v)) < 2e-3


def test_sign_a_specimen_that_moves_right_and_down_has_positive_u_and_v(lab, scene, measure):
    m = measure(lab.expose(scene()), np.roll(lab.expose(scene()), (3, 5), axis=(0, 1)), SETTINGS)
    assert np.median(m.u_px) == pytest.approx(5.0, abs=1e-6)
    assert np.median(m.v_px) == pytest.approx(3.0, abs=1e-6)


@pytest.mark.parametrize("motion", [(55.0, 3.0), (-40.3, -38.6), (2.5, -57.2)])
def test_large_shifts_are_found_and_lost_points_report_where_they_went(lab, scene, measure, motion):
    u, v = motion
    first, second = lab.expose(scene(), 7.0, 1), lab.expose(scene(lab.Affine(u=u, v=v)), 7.0, 2)
    m = measure(first, second, DicSettings(step_px=6, roi_px=None))
    x, y = m.grid.mesh()
    inside = (x + u >= 22) & (x + u <= 277) & (y + v >= 22) & (y + v <= 237)
    gone = (x + u < 20) | (x + u > 279) | (y + v < 20) | (y + v > 239)
    assert m.valid[inside].all()
    assert np.max(np.hypot(m.u_px - u, m.v_px - v)[inside]) < 0.15
    assert not m.valid[gone].any()
    assert np.mean(np.isin(m.status[gone], [3])) > 0.9  # OUTSIDE_IMAGE


def test_a_jump_within_the_frame_is_followed_on_both_sides(lab, scene, measure):
    above, below = scene(lab.Affine(u=2.3, v=0.4)), scene(lab.Affine(u=-14.6, v=7.1))
    current = np.where(np.arange(260)[:, None] < 130, above, below)
    m = measure(lab.expose(scene(), 5.0, 1), lab.expose(current, 5.0, 2), DicSettings(step_px=6, roi_px=(40, 36, 264, 224)))
    _, y = m.grid.mesh()
    first, second = y + 22 < 129, y + 7.1 - 22 > 130
    assert m.valid[first | second].all()
    assert np.max(np.abs(m.u_px[first] - 2.3)) < 0.1
    assert np.max(np.abs(m.u_px[second] + 14.6)) < 0.1


def test_sixteen_bit_and_contrast_changes_do_not_matter(lab, scene, measure):
    current = scene(lab.Affine(u=0.4, v=0.7))
    eight = measure(lab.expose(scene()), lab.expose(current), SETTINGS)
    sixteen = measure(lab.expose(scene(), bits=16), lab.expose(40.0 + 0.6 * current, bits=16), SETTINGS)
    assert sixteen.valid.all()
    assert np.max(np.abs(eight.u_px - sixteen.u_px)) < 5e-3  # rounding to 8 bit: sigma 7e-4 px
    assert abs(np.mean(sixteen.u_px) - 0.4) < 1e-3


def test_fine_speckle_converges_too(lab, measure):
    speckle = lab.Speckle(200, 160, spot_px=1.0, seed=3)
    motion = lab.Affine(u=4.4, v=-3.3)
    m = measure(lab.expose(speckle.render(), 4.0, 1), lab.expose(speckle.render(motion), 4.0, 2), DicSettings(31, 8, (25, 25, 175, 135)))
    assert m.valid.all()
    assert abs(np.mean(m.u_px) - 4.4) < 5e-3  # the cubic spline's own bias on speckle of 3.3 px
    assert abs(np.mean(m.v_px) + 3.3) < 5e-3


def test_an_image_correlates_with_itself_perfectly(lab, scene, measure):
    image = lab.expose(scene(), 7.0, 1)
    m = measure(image, image, DicSettings(step_px=1, roi_px=(0, 21, 299, 60)))
    assert m.grid.nx == 258  # subsets on both edges of the frame are held, not lost to rounding
    assert m.valid.all()
    assert np.max(np.abs(m.u_px)) < 0.1 * SETTINGS.tolerance_px
    assert np.min(m.zncc) > 1.0 - 1e-6
    assert 1e-4 < np.min(m.sigma_u_px) < np.max(m.sigma_u_px) < 2e-3  # rounding: never zero, others divide by it


def test_threads_do_not_change_the_result(lab, scene, measure, monkeypatch):
    first, second = lab.expose(scene(), 7.0, 1), lab.expose(scene(lab.Affine(u=20.3, v=1.7)), 7.0, 2)
    maps = []
    for threads in (1, 2, 5):
        monkeypatch.setattr("semlive.kernels.threads.thread_count", lambda n=threads: n)
        maps.append(measure(first, second, DicSettings(step_px=6, roi_px=None)))
    for m in maps[1:]:
        for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "status"):
            assert np.array_equal(getattr(maps[0], name), getattr(m, name)), name


def test_a_reference_is_prepared_once_and_used_often(lab, scene):
    grid = dic.grid_for(SETTINGS, 300, 260)
    reference = dic.prepare(lab.expose(scene()), grid, SETTINGS)
    current = lab.expose(scene(lab.Affine(u=0.4, v=0.7)))
    once = dic.correlate(reference, current, SETTINGS, reference_frame=2, current_frame=3)
    again = dic.correlate(reference, current, SETTINGS, reference_frame=2, current_frame=5)
    assert np.array_equal(once.u_px, again.u_px)
    assert (again.reference, again.current) == (2, 5)
    with pytest.raises(ValueError, match="read-only"):
        reference.sums.mean[0, 0] = 1.0


def test_after_warm_up_nothing_is_compiled():
    """A clean pair, one with suspect and decorrelated points, one with a mask, 16 bit: the daemon must not wait for a compiler in use."""
    script = """
import importlib, pkgutil, sys
import cv2, numpy as np
from semlive import dic, kernels
from semlive.data.settings import DicSettings

def compiled():
    modules = [importlib.import_module("semlive.kernels." + m.name) for m in pkgutil.iter_modules(kernels.__path__) if m.name != "rows"]
    found = {f"{m.__name__}.{name}": len(k.signatures) for m in modules for name, k in vars(m).items() if hasattr(k, "py_func")}
    assert len(found) > 15
    return found

settings = DicSettings(subset_px=21, step_px=8, roi_px=None)
dic.warm_up(settings)
before = compiled()
speckle = cv2.GaussianBlur(np.random.default_rng(1).standard_normal((160, 200)), (0, 0), 2.0)
first = np.clip(128.0 + 280.0 * speckle, 0, 255).astype(np.uint8)
second = np.roll(first, 1, axis=1)
decorrelated = second.copy()
decorrelated[:, 100:] = np.roll(second, 3, axis=0)[:, 100:]
decorrelated[60:90, 40:60] = 128
mask = np.ones(first.shape, dtype=bool)
mask[:50, :50] = False
wide = first.astype(np.uint16) * 200, second.astype(np.uint16) * 200
for pair, hidden in (((first, second), None), ((first, decorrelated), None), ((first, second), mask), (wide, None)):
    m = dic.match(*pair, settings=settings, mask=hidden)
    print(len(set(m.status.ravel().tolist())), m.valid.mean(), file=sys.stderr)
print({name: count for name, count in compiled().items() if count != before[name]})
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == "{}"
