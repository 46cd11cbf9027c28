"""What must hold of the kernels whatever the image: numbers of bits, processors, threads, and the motion's symmetry."""

import os
import subprocess
import sys

import numpy as np
import pytest

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.kernels import threads

SETTINGS = DicSettings(step_px=24, roi_px=(36, 36, 264, 224))


def test_strain_and_poissons_ratio_are_not_biased_by_noise(lab):
    """A plane through the errors of a strained pair, 8 grey of noise (0.02 px): exx and eyy, and their ratio, stay what they are.

    40 draws on 1024 x 884 px give exx (-1.5 +- 5)e-7 and eyy (4.3 +- 6)e-7 off what they are without noise, of a strain of 2e-3:
    Poisson's ratio changes by (0 +- 3)e-4. Without noise the cubic spline's S-shaped error moves it by up to 3e-4 with the
    sub-pixel phase; the quintic one's by 1e-4. This is a short version of that campaign.
    """
    strain, ratio = 8e-3, 0.33
    speckle = lab.Speckle(330, 290, seed=5)
    motion = lab.Affine(u=0.3, v=0.2, ux=-ratio * strain, vy=strain, xc=165, yc=145)
    still, moved = speckle.render(), speckle.render(motion)
    settings = DicSettings(step_px=20, roi_px=(25, 25, 304, 264))
    grid = dic.grid_for(settings, 330, 290)
    x, y = grid.mesh()
    plane = np.linalg.pinv(np.column_stack([np.ones(x.size), x.ravel() - 165.0, y.ravel() - 145.0]))
    u, v = motion.at(x, y)
    found = []
    for draw in range(24):
        reference = dic.prepare(lab.expose(still, 8.0, 100 + 2 * draw), grid, settings)
        m = dic.correlate(reference, lab.expose(moved, 8.0, 101 + 2 * draw), settings, reference_frame=0, current_frame=1)
        assert m.valid.all()
        found.append([(plane @ (m.u_px - u).ravel())[1], (plane @ (m.v_px - v).ravel())[2]])
    mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    assert np.all(error < 1.5e-5)
    assert np.all(np.abs(mean) < 4.0 * error + 3e-6)  # the spline's own error over so small a frame


@pytest.mark.parametrize(
    "settings",
    [
        DicSettings(43, 24, (36, 36, 264, 224), tolerance_px=2e-5),
        DicSettings(31, 24, (36, 36, 264, 224), tolerance_px=2e-5, shape_function="quadratic"),
    ],
)
def test_large_offsets_and_sixteen_bits_lose_nothing(lab, scene, settings):
    """A ramp of 25,000 grey levels under speckle of 1,600: float32 sums must not feel it."""
    motion = lab.Affine(u=0.3, v=-0.4)
    x = np.arange(300)
    grid = dic.grid_for(settings, 300, 260)
    maps = []
    for step in (0.0, 25_000.0):
        offset = step * (x > 150)  # constant in nearly every subset, so that nothing but the arithmetic changes
        pair = [np.round(8000.0 + offset + 40.0 * scene(m)).astype(np.uint16) for m in (lab.Affine(), motion)]
        maps.append(dic.correlate(dic.prepare(pair[0], grid, settings), pair[1], settings, reference_frame=0, current_frame=1))
    clear = np.abs(grid.mesh()[0] - 150) > settings.subset_px // 2 + 16
    plain, raised = maps
    assert np.all(plain.valid[clear] & raised.valid[clear])
    assert np.max(np.abs(plain.u_px - raised.u_px)[clear]) < 1e-4
    assert np.max(np.abs(plain.v_px - raised.v_px)[clear]) < 1e-4
    assert np.max(np.abs(plain.zncc - raised.zncc)[clear]) < 1e-5


@pytest.mark.parametrize("options", [{}, {"interpolation": "quintic", "shape_function": "quadratic"}])
def test_a_shift_by_integer_pixels_shifts_the_result_and_nothing_else(lab, scene, measure, options):
    settings = DicSettings(step_px=24, roi_px=(60, 60, 240, 200), **options)
    first, second = lab.expose(scene(), 4.0, 1), lab.expose(scene(lab.Affine(u=0.4, v=-0.3)), 4.0, 2)
    here = measure(first, second, settings)
    there = measure(first, np.roll(second, (3, -5), axis=(0, 1)), settings)
    assert np.array_equal(here.valid, there.valid)
    assert np.max(np.abs(there.u_px - here.u_px + 5.0)) < 5e-4
    assert np.max(np.abs(there.v_px - here.v_px - 3.0)) < 5e-4


def test_forth_and_back_cancel(lab, scene, measure):
    first, second = lab.expose(scene(), 3.0, 1), lab.expose(scene(lab.Affine(u=0.4, v=-0.3)), 3.0, 2)
    forth, back = measure(first, second, SETTINGS), measure(second, first, SETTINGS)
    closure = np.concatenate([(forth.u_px + back.u_px).ravel(), (forth.v_px + back.v_px).ravel()])
    assert np.sqrt(np.mean(closure**2)) < 0.5 * np.mean(forth.sigma_u_px)  # the same noise, but for half a pixel of place
    assert abs(np.mean(closure)) < 5e-4


def test_both_axes_give_equal_results(lab, scene, measure):
    first, second = lab.expose(scene(), 3.0, 1), lab.expose(scene(lab.Affine(u=0.4, v=-0.3)), 3.0, 2)
    plain = measure(first, second, SETTINGS)
    turned = measure(np.ascontiguousarray(first.T), np.ascontiguousarray(second.T), DicSettings(step_px=24, roi_px=(36, 36, 224, 264)))
    assert np.max(np.abs(plain.u_px - turned.v_px.T)) < 5e-4
    assert np.max(np.abs(plain.v_px - turned.u_px.T)) < 5e-4
    assert np.allclose(plain.sigma_u_px, turned.sigma_v_px.T, rtol=2e-2)


SCRIPT = """
import gc
gc.disable()  # Numba creates many long-lived objects: garbage collection took a tenth of the time of a compilation
import sys, numpy as np
from semlive import dic
from semlive.data.settings import DicSettings
from semlive.kernels.subset_matching import interface
first, second = np.load(sys.argv[1])
settings = DicSettings(step_px=24, roi_px=(36, 36, 264, 224), interpolation=sys.argv[3])
reference = dic.prepare(first, dic.grid_for(settings, 300, 260), settings)
m = dic.correlate(reference, second, settings, reference_frame=0, current_frame=1)
np.save(sys.argv[2], np.stack([m.u_px, m.v_px, m.sigma_u_px, m.zncc, m.status]))
"""


def test_a_processor_without_avx_gives_the_same_answer(lab, scene, tmp_path):
    pair = np.stack([lab.expose(scene(), 3.0, 1), lab.expose(scene(lab.Affine(u=0.4, v=-0.3)), 3.0, 2)])
    np.save(tmp_path / "pair.npy", pair)
    results = []
    for name, features in (("own", None), ("generic", "")):
        environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
        if features is not None:
            # a cache of its own: what is compiled for one processor must not serve another
            environment |= {
                "NUMBA_CPU_NAME": "generic",
                "NUMBA_CPU_FEATURES": features,
                "NUMBA_OPT": "1",
                "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
            }
        command = [sys.executable, "-c", SCRIPT, str(tmp_path / "pair.npy"), str(tmp_path / f"{name}.npy"), "cubic"]
        subprocess.run(command, check=True, timeout=300, env=environment)
        results.append(np.load(tmp_path / f"{name}.npy"))
    own, generic = results
    assert np.array_equal(own[4], generic[4])
    assert np.max(np.abs(own[:2] - generic[:2])) < 1e-4
    assert np.max(np.abs(own[3] - generic[3])) < 1e-5


@pytest.mark.parametrize("options", [{"interpolation": "quintic"}, {"shape_function": "quadratic"}, {"shape_function": "quartic"}])
def test_threads_do_not_change_the_result(lab, scene, measure, monkeypatch, options):
    first, second = lab.expose(scene(), 7.0, 1), lab.expose(scene(lab.Affine(u=2.3, v=1.7)), 7.0, 2)
    maps = []
    for count in (1, 2):
        monkeypatch.setattr("semlive.kernels.threads.thread_count", lambda n=count: n)
        maps.append(measure(first, second, DicSettings(step_px=12, roi_px=None, **options)))
    assert threads.thread_count() == 2
    for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "status"):
        assert np.array_equal(getattr(maps[0], name), getattr(maps[1], name)), name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"interpolation": "linear"}, "interpolation must be cubic or quintic"),
        ({"shape_function": "rigid"}, "shape_function must be affine, quadratic or quartic"),
        ({"min_valid_fraction": 0.0}, "min_valid_fraction must be above 0"),
    ],
)
def test_settings_take_only_what_exists(change, message):
    with pytest.raises(ValueError, match=message):
        DicSettings(**change)
