"""What a run that is followed pair by pair holds in memory: little for every pair, though its result knows them all."""

from __future__ import annotations

import tempfile
import tracemalloc

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive import pipeline
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.experiment import Phase, Step
from semlive.data.frame import FrameInfo
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import AnalysisSettings, EstimateSettings
from semlive.estimate.blocks import BlockColumns, PackedColumns, StoredColumns
from semlive.estimate.state import in_memory
from semlive.formats.messages import DriftMessage, from_json, to_json
from semlive.model import Axis
from semlive.service.map_store import MapStore, beside_memory
from semlive.service.seen import drift_word

GRID = Grid(40, 40, 10, 40, 30, 43)
EVERY, LAST = 49, 61  # between two choices


def timing() -> ScanTiming:
    made = [Sourced(value, Provenance.CONFIG) for value in (1e-4, 0.05, 12.0)]
    return ScanTiming(made[0], made[1], made[2], Sourced(1, Provenance.CONFIG))


def decision(pair: int) -> PairDecision:
    infos = []
    for member in (0, 1):
        start = Sourced(round((60.0 * pair + 14.0 * member) * 1e9), Provenance.FILE)
        pixel = Sourced(1e-6, Provenance.FILE)
        infos.append(FrameInfo(2 * pair + member, f"{pair}-{member}.tif", "fei", 480, 380, 0, timing(), start, 0.01, pixel))
    return PairDecision(pair, Step(pair, Phase.CALIBRATION, (0.0, 0.0), (0.0, 0.0), None), infos[0], infos[1], None)


def maps(pair: int) -> tuple[DisparityMap, ...]:
    n, found = 2 * pair, []
    for reference, current in [(n, n + 1)] + ([(0, n), (0, n + 1)] if pair else []):
        rng = np.random.default_rng((pair, reference, current))
        u, v = 0.02 * (60.0 * (current // 2 - reference // 2) + 14.0 * (current % 2)) + rng.normal(0, 0.02, (2, *GRID.shape))
        status = np.where(rng.random(GRID.shape) < 0.02, PoiStatus.LOW_ZNCC, PoiStatus.CONVERGED).astype(np.uint8)
        sigma = rng.uniform(0.01, 0.03, GRID.shape)
        found.append(DisparityMap(reference, current, GRID, u.copy(), v.copy(), sigma, 1.3 * sigma, np.ones(GRID.shape), status))
    return tuple(found)


def followed(begun: pipeline.Begun | None, pairs: range, store: MapStore) -> pipeline.Begun:
    """As the daemon's analysis does it, but for the pixels."""
    settings = AnalysisSettings(estimate=EstimateSettings(drift_knots_per_frame=1.0, distortion_knot_px=160.0))
    for pair in pairs:
        begun = begun or pipeline.begin_from_maps(settings, decision(0).first, GRID)
        begun, _ = pipeline.update(begun, decision(pair), tuple(begun.keep(one) for one in maps(pair)))
        begun = beside_memory(begun, pair, (), store)
        store.settle()
    assert begun is not None
    return begun


def test_a_pair_of_a_run_takes_little_memory() -> None:
    """Its maps and columns, 0.5 MB here, lay in files and in memory as well, where the solution held them."""
    store = MapStore(in_memory_bytes=0)
    begun = followed(None, range(EVERY), store)
    tracemalloc.start()
    try:
        begun = followed(begun, range(EVERY, EVERY + 2), store)  # what is made once
        before, _ = tracemalloc.get_traced_memory()
        begun = followed(begun, range(EVERY + 2, LAST), store)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 40_000 * (LAST - EVERY - 2)
    assert begun.estimator.rows[-1] is begun.solution.state.rows[-1]
    assert begun.pairs[-1].first.timing is begun.pairs[0].first.timing


def test_a_run_kept_beside_memory_is_the_same_to_the_last_bit() -> None:
    runs = [followed(None, range(14), MapStore(in_memory_bytes=size)) for size in (0, 2**30)]
    means = [one.solution.mean for one in runs]
    np.testing.assert_array_equal(means[0], means[1])
    state, known = estimating.init(runs[0].settings.estimate, GRID, 480, 380), None
    for pair in range(14):
        times = pipeline.frame_times(decision(0), decision(pair))
        state = estimating.update(state, pair, Phase.CALIBRATION, (times[0], times[1]), maps(pair))
        known = estimating.live(state, known)
    assert known is not None
    np.testing.assert_array_equal(known.mean, means[0])


def test_stored_columns_are_what_was_stored() -> None:
    rng = np.random.default_rng(4)
    full = np.zeros((5, 9, 11))
    full[:, 2:5, 3:7] = rng.normal(size=(5, 3, 4))
    packed = PackedColumns.of(BlockColumns("distortion", Axis.EACH, np.arange(99), full.reshape(5, -1)), (9, 11))
    own = BlockColumns("drift", Axis.X, np.arange(7, 10), rng.normal(size=(5, 3)))
    one, two, three = StoredColumns.of((own, packed, own), in_memory).columns()
    for found in (one, three):
        assert isinstance(found, BlockColumns)
        assert (found.effect, found.axis) == ("drift", Axis.X)
        np.testing.assert_array_equal(found.index, own.index)
        np.testing.assert_array_equal(found.value, own.value)
    assert isinstance(two, PackedColumns)
    assert (two.effect, two.shape) == ("distortion", (9, 11))
    np.testing.assert_array_equal(two.unpacked().value, full.reshape(5, -1))


def test_what_finds_no_room_in_files_stays_in_memory_if_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "/no/such/folder")
    array = np.arange(10.0)
    assert MapStore(in_memory_bytes=0, stays=True).keep_array(array) is array
    with pytest.raises(OSError, match="No such file"):
        MapStore(in_memory_bytes=0).keep_array(array)


def test_control_reads_of_a_drift_what_it_decides_on() -> None:
    """All of it took 8 kB for every pair of the run, whenever all frames were told anew."""
    count = 20_000
    column: tuple[tuple[float, float], ...] = tuple((float(x), float(y)) for x, y in np.random.default_rng(1).normal(size=(count, 2)))
    told = DriftMessage(
        revision=500,
        time_s=tuple(np.arange(count, dtype=float).tolist()),
        frame=tuple(np.repeat(np.arange(count // 20), 20).tolist()),
        drift_px=column,
        sigma_px=column,
        rate_px_s=column,
        rate_x_px_s=column[-1][0],
        rate_y_px_s=column[-1][1],
    )
    payload = to_json(told)
    word = drift_word(payload)
    assert (word.revision, word.newest_pair, word.rate_x_px_s, word.forecast) == (500, count // 40 - 1, column[-1][0], None)
    del told, column
    peaks = []
    for read in (lambda: drift_word(payload), lambda: from_json("/drift/estimate", payload)):
        tracemalloc.start()
        read()
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[0] < 0.5 * len(payload)
    assert peaks[1] > 2.0 * len(payload)
