"""Runs without an effect from a generator that shares no code with semlive. Each was given an effect, or UNKNOWN, for the reason stated."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from foreign.noise import SHAPES
from foreign.world import Raster, Series, write

from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.service.diagnosis.run import diagnose_log
from semlive.service.log.opened_log import OpenedLog
from semlive.service.replay.import_maps import ImportRequest, import_folder

RASTER = Raster(width=640, height=552, step_px=16, margin_px=64)


@cache
def diagnosed(shape: str, seed: int) -> tuple[Diagnosis, Observation]:
    """Verdict on seven pairs of maps, imported without a hint about the subset."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write(Series(seed, 4, 3, raster=RASTER), SHAPES[shape], folder / "maps")
        import_folder(ImportRequest(folder / "maps", folder / "maps.mcap"))
        return diagnose_log(OpenedLog(folder / "maps.mcap"))


@pytest.mark.parametrize(
    ("shape", "seed"),
    [
        pytest.param("square", 700_017, id="drift with a fast relaxation"),
        pytest.param("smoothed", 700_029, id="few independent points"),
        pytest.param("composed, own", 700_064, id="interpolated noise of composed maps"),
        pytest.param("composed, own", 700_059, id="noise of composed maps independent of the fraction of the grid distance"),
        pytest.param("heavy tails, rounded", 700_015, id="a fifth of the variance at each point"),
        pytest.param("smoothed", 700_035, id="window longer than the estimated subset"),
    ],
)
def test_noise_is_no_effect(shape: str, seed: int) -> None:
    found, _ = diagnosed(shape, seed)
    assert (found.outcome, found.effects) == (Outcome.NONE, ())


def test_noise_shared_by_the_frames_of_a_pair_is_no_fine_distortion() -> None:
    """Runs of composed maps with another distribution of the noise were searched again only if they had an effect or were UNKNOWN."""
    found, _ = diagnosed("composed, own", 700_001)
    assert (found.outcome, found.coarse) == (Outcome.NONE, ())


def test_a_drift_that_relaxes_from_the_start_is_more_likely_than_a_uniformly_curved_one() -> None:
    """Decays within 130 to 600 s, knots 30 s apart: no curvature of one size describes them."""
    _, observation = diagnosed("square", 700_017)
    points = [
        (point.prior_choice[0], point.evidence) for point in noise_scaled_baseline(observation).points if point.prior_choice is not None
    ]
    relaxed, uniform = (max(evidence for prior, evidence in points if bool(prior.relaxation_px) is kind) for kind in (True, False))
    assert relaxed > uniform + 15.0
