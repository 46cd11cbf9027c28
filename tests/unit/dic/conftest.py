import importlib.util
import sys
from pathlib import Path

import pytest

from semlive import dic
from semlive.data.settings import DicSettings


def _load():
    name = "dic_speckle"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name("speckle.py"))
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture(scope="session")
def lab():
    """The renderer: Affine, Speckle, expose."""
    return _load()


@pytest.fixture(scope="session")
def scene(lab):
    """One speckled specimen in a small frame, with renderings kept."""
    speckle = lab.Speckle(300, 260)
    stored = {}

    def render(motion=None):
        motion = motion or lab.Affine()
        if motion not in stored:
            stored[motion] = speckle.render(motion)
        return stored[motion]

    return render


@pytest.fixture(scope="session")
def measure():
    """Correlate two images: (reference, current, settings) -> DisparityMap."""

    def run(first, second, settings=None):
        settings = settings or DicSettings(step_px=12, roi_px=None)
        grid = dic.grid_for(settings, first.shape[1], first.shape[0])
        reference = dic.prepare(first, grid, settings)
        return dic.correlate(reference, second, settings, reference_frame=0, current_frame=1)

    return run
