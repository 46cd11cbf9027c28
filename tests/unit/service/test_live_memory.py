"""What a run that is followed pair by pair holds in memory: little for every pair, though its result uses all of them."""

from __future__ import annotations

import gc
import tempfile
import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest

from semlive import pipeline
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.experiment import Phase, Step
from semlive.data.frame import FrameInfo
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import AnalysisSettings, EstimateSettings
from semlive.estimate.joint.observations import accumulation
from semlive.estimate.joint.observations.block_means import BlockColumns, PackedColumns, StoredColumns
from semlive.estimate.storage import IN_MEMORY, Storage
from semlive.formats.log.messages import DriftMessage, from_json, to_json
from semlive.model import Axis
from semlive.service.control.analysis_events import parse_drift_update
from semlive.service.storage.map_store import MapStore, offload_pair
from semlive.service.storage.pair_archive import PairArchive

GRID = Grid(40, 40, 10, 40, 30, 43)
EVERY, LAST = 34, 46  # between two choices; pairs before the newest 32 are no longer smoothed
DENSE_KNOTS = 64  # those of 12 pairs


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


def followed(state: pipeline.AnalysisState | None, pairs: range, keep: Storage) -> pipeline.AnalysisState:
    """As the daemon's analysis does it, but for the pixels."""
    settings = AnalysisSettings(estimate=EstimateSettings(drift_knots_per_frame=1.0, distortion_knot_px=160.0))
    for pair in pairs:
        state = state or pipeline.start_from_maps(settings, decision(0).first, GRID)
        state, _ = pipeline.add_pair(state, decision(pair), tuple(state.storage.store_map(one) for one in maps(pair)))
        state = offload_pair(state, pair, (), keep)
        state, _ = pipeline.review_hyperparameters(state)
        if isinstance(keep, PairArchive | MapStore):
            keep.flush()
    assert state is not None
    return state


def held_bytes() -> int:
    """Without what only waits to be collected: up to 70 kB a pair, where many other objects are in memory."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


StoredRun = tuple[pipeline.AnalysisState, Storage]


@pytest.fixture(scope="module", autouse=True)
def small_matrix() -> Iterator[None]:
    """A dense matrix of 12 pairs instead of 32: the choices after 16, 24 and 32 pairs are those of a long run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(accumulation, "DENSE_KNOTS", DENSE_KNOTS)
        yield


@pytest.fixture(scope="module")
def live() -> StoredRun:
    """A live run beyond 12 pairs, from where on pairs are eliminated one by one, with a choice at 32, and where it is kept."""
    keep = PairArchive()
    return followed(None, range(EVERY), keep), keep


@pytest.fixture(scope="module")
def replayed() -> StoredRun:
    """The same of a replay."""
    keep = MapStore(in_memory_bytes=0)
    return followed(None, range(EVERY), keep), keep


def test_a_run_stored_outside_of_memory_is_identical_to_the_last_bit(live: StoredRun, replayed: StoredRun) -> None:
    plain = followed(None, range(EVERY), IN_MEMORY)
    expected = pipeline.finalise(plain)
    for one, _ in (live, replayed):
        np.testing.assert_array_equal(one.solution.mean, plain.solution.mean)
        assert (one.solution.hyper, one.solution.terms) == (plain.solution.hyper, plain.solution.terms)
        assert list(one.pairs) == list(plain.pairs)
        assert list(one.reported) == list(plain.reported)
        assert [report.summary for report in one.reported.values()] == [report.summary for report in plain.reported.values()]
        result = pipeline.finalise(one)
        assert result.summaries == expected.summaries
        assert result.estimate.motions[-1].shift_px.tolist() == expected.estimate.motions[-1].shift_px.tolist()


def grown_bytes(run: StoredRun) -> float:
    """By how much a pair makes what is held in memory grow, between two choices."""
    state, keep = run
    tracemalloc.start()
    try:
        state = followed(state, range(EVERY, EVERY + 2), keep)  # what is made once
        before = held_bytes()
        state = followed(state, range(EVERY + 2, LAST), keep)
        after = held_bytes()
    finally:
        tracemalloc.stop()
    return (after - before) / (LAST - EVERY - 2)


def test_a_pair_of_a_replay_takes_little_memory(replayed: StoredRun) -> None:
    """Its maps and columns, 0.5 MB here, lay in files and in memory as well, where the solution held them."""
    assert grown_bytes(replayed) < 40_000


def test_a_pair_of_a_live_run_takes_next_to_none(live: StoredRun) -> None:
    """Some 0.6 kB a pair, and what NumPy holds ready once, which within ten pairs looks like 3 kB a pair."""
    assert grown_bytes(live) < 6_000


def test_stored_columns_are_what_was_stored() -> None:
    rng = np.random.default_rng(4)
    full = np.zeros((5, 9, 11))
    full[:, 2:5, 3:7] = rng.normal(size=(5, 3, 4))
    packed = PackedColumns.of(BlockColumns("distortion", Axis.EACH, np.arange(99), full.reshape(5, -1)), (9, 11))
    own = BlockColumns("drift", Axis.X, np.arange(7, 10), rng.normal(size=(5, 3)))
    one, two, three = StoredColumns.of((own, packed, own), IN_MEMORY).columns()
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
    assert MapStore(in_memory_bytes=0, stays=True).store_array(array) is array
    with pytest.raises(OSError, match="No such file"):
        MapStore(in_memory_bytes=0).store_array(array)


def test_control_reads_of_a_drift_what_it_decides_on() -> None:
    """Storing all of it took 8 kB for every pair of the run, whenever all frames were reported again."""
    count = 20_000
    column: tuple[tuple[float, float], ...] = tuple((float(x), float(y)) for x, y in np.random.default_rng(1).normal(size=(count, 2)))
    message = DriftMessage(
        revision=500,
        newest_pair=count // 40 - 1,
        time_s=tuple(np.arange(count, dtype=float).tolist()),
        frame=tuple(np.repeat(np.arange(count // 20), 20).tolist()),
        drift_px=column,
        sigma_px=column,
        rate_px_s=column,
        rate_x_px_s=column[-1][0],
        rate_y_px_s=column[-1][1],
    )
    payload = to_json(message)
    update = parse_drift_update(payload)
    assert (update.revision, update.newest_pair, update.rate_x_px_s, update.forecast) == (500, count // 40 - 1, column[-1][0], None)
    older = parse_drift_update(to_json(message.model_copy(update={"newest_pair": None})))
    assert older == update
    del message, column
    peaks = []
    for read in (lambda: parse_drift_update(payload), lambda: from_json("/drift/estimate", payload)):
        tracemalloc.start()
        read()
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[0] < 0.5 * len(payload)
    assert peaks[1] > 2.0 * len(payload)
