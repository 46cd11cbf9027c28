"""What goes into a log comes out of it: messages, maps, complete files, and truncated ones up to the cut."""

from __future__ import annotations

import contextlib
import json
from io import BytesIO

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from semlive.data.clock import Clock
from semlive.data.disparity import DisparityMap
from semlive.data.drift import DistortionField, DriftEstimate, DriftForecast, PairMotion
from semlive.data.experiment import Phase, Step
from semlive.data.frame import FrameInfo
from semlive.data.grid import Grid
from semlive.data.loading import FrameLoad, LoadSample, MotionState, StageSample
from semlive.data.pair import PairDecision
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.scan_report import ScanReading, ScanReport
from semlive.data.strain import Displacement, ElasticConstants, MeasuredValue, StrainField, StrainSummary, Tensor2
from semlive.errors import BadLog
from semlive.formats.log import conversions as values
from semlive.formats.log.maps import decode_displacement, decode_map, decode_strain, encode_displacement, encode_map, encode_strain
from semlive.formats.log.messages import DIC_MAP, SEM_ORIGINAL, TOPICS, DicMessage, LogLineMessage, from_json, json_schema, to_json
from semlive.formats.log.reader import LogMessage, read_messages
from semlive.formats.log.writer import LogWriter

FLOAT = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(1e-9, 1e6)
TIME_NS = st.integers(0, 2**62)
COUNT = st.integers(0, 10**6)
TEXT = st.text(st.characters(codec="utf-8"), max_size=20)
POINT = st.tuples(FLOAT, FLOAT)


def sourced(value: st.SearchStrategy) -> st.SearchStrategy[Sourced]:
    return st.builds(Sourced, value, st.sampled_from(Provenance))


TIMINGS = st.builds(ScanTiming, sourced(POSITIVE), sourced(POSITIVE), sourced(POSITIVE), sourced(st.integers(1, 64)))
SIZE = st.integers(1, 20_000)
INFOS = st.builds(FrameInfo, COUNT, TEXT, TEXT, SIZE, SIZE, COUNT, TIMINGS, sourced(TIME_NS), FLOAT, sourced(POSITIVE))
LOADS = st.builds(FrameLoad, FLOAT, FLOAT, FLOAT, FLOAT, st.none() | FLOAT, st.none() | FLOAT)
STEPS = st.builds(Step, COUNT, st.sampled_from(Phase), POINT, POINT, st.none() | FLOAT)
PAIRS = st.builds(PairDecision, COUNT, STEPS, INFOS, INFOS, st.none() | st.tuples(LOADS, LOADS))
TENSORS = st.builds(Tensor2, FLOAT, FLOAT, FLOAT)
REGISTERS = st.lists(st.integers(0, 65535), max_size=16).map(tuple)
SAMPLES = st.builds(
    LoadSample, COUNT, TIME_NS, TIME_NS, FLOAT, FLOAT, st.sampled_from(MotionState), FLOAT, st.none() | FLOAT, REGISTERS, st.none() | FLOAT
)
STAGES = st.builds(StageSample, COUNT, TIME_NS, TIME_NS, FLOAT, FLOAT, st.sampled_from(MotionState), REGISTERS)
OTHERS = st.dictionaries(TEXT, TEXT, max_size=4).map(lambda items: tuple(items.items()))
READINGS = st.builds(ScanReading, TIME_NS, POSITIVE, st.none() | POSITIVE, POSITIVE, SIZE, SIZE, OTHERS)
SCAN_REPORTS = st.builds(ScanReport, READINGS, READINGS, TEXT, TIME_NS, st.none() | POSITIVE)
MEASURED = st.builds(MeasuredValue, FLOAT, FLOAT)
GRIDS = st.builds(Grid, COUNT, COUNT, SIZE, st.integers(1, 6), st.integers(1, 6), SIZE)


def random_map(grid: Grid, seed: int) -> DisparityMap:
    rng = np.random.default_rng(seed)
    u, v, su, sv, zncc = rng.normal(size=(5, *grid.shape)) * 10.0 ** rng.integers(-12, 12)
    return DisparityMap(0, seed, grid, u, v, su, sv, zncc, rng.integers(0, 6, grid.shape).astype(np.uint8))


@given(
    st.one_of(
        INFOS.map(lambda item: (values.scan_message, values.frame_info, item)),
        PAIRS.map(lambda item: (values.pair_message, values.pair_decision, item)),
        SAMPLES.map(lambda item: (values.load_sample_message, values.load_sample, item)),
        STAGES.map(lambda item: (values.stage_sample_message, values.stage_sample, item)),
        SCAN_REPORTS.map(lambda item: (values.trigger_message, values.trigger_report, item)),
    )
)
def test_nouns_come_back_equal_from_json(case: tuple) -> None:
    to_message, to_noun, noun = case
    message = to_message(noun)
    topic = next(name for name, model in TOPICS.items() if isinstance(message, model))
    payload = to_json(message)
    back = from_json(topic, payload)
    assert to_noun(back) == noun
    assert to_json(back) == payload


@given(st.builds(Clock, TIME_NS, TIME_NS, POSITIVE, COUNT), st.builds(StrainSummary, COUNT, TENSORS, TENSORS, TENSORS, FLOAT))
def test_clock_and_strain_come_back(clock: Clock, summary: StrainSummary) -> None:
    assert values.clock(from_json("/clock", to_json(values.clock_message(clock, "start")))) == clock  # type: ignore[arg-type]
    assert values.strain_summary(from_json("/strain/summary", to_json(values.strain_message(summary, 3)))) == summary  # type: ignore[arg-type]


@given(st.none() | st.builds(ElasticConstants, MEASURED, MEASURED))
def test_elastic_constants_come_back(elastic: ElasticConstants | None) -> None:
    assert values.elastic_constants(from_json("/elastic", to_json(values.elastic_message(elastic, 1)))) == elastic  # type: ignore[arg-type]


@settings(max_examples=30)
@given(GRIDS, st.integers(0, 2**31 - 1))
def test_estimates_come_back_to_the_last_bit(grid: Grid, seed: int) -> None:
    rng = np.random.default_rng(seed)
    forecast = DriftForecast(rng.normal(size=3), float(rng.normal()), *rng.normal(size=(2, 3, 2)))
    drift = DriftEstimate(rng.normal(size=5), np.arange(5), *rng.normal(size=(3, 5, 2)), revision=4, forecast=forecast)
    message = values.drift_message(drift)
    assert message.newest_pair == 2
    drift_back = values.drift_estimate(from_json("/drift/estimate", to_json(message)))  # type: ignore[arg-type]
    assert drift_back.revision == 4
    for name in ("time_s", "frame", "drift_px", "sigma_px", "rate_px_s"):
        assert np.array_equal(getattr(drift_back, name), getattr(drift, name))
    assert drift_back.forecast is not None
    for name in ("time_s", "duration_s", "rate_px_s", "sigma_px_s"):
        assert np.array_equal(getattr(drift_back.forecast, name), getattr(forecast, name))
    field = DistortionField(grid, *rng.normal(size=(3, *grid.shape)), rng.integers(0, 2, grid.shape).astype(bool))
    field_back = values.distortion_field(from_json("/distortion/estimate", to_json(values.distortion_message(field, 4))))  # type: ignore[arg-type]
    assert field_back.grid == grid
    for name in ("ex_px", "ey_px", "sigma_px", "valid"):
        assert np.array_equal(getattr(field_back, name), getattr(field, name))
    motion = PairMotion(3, rng.normal(size=2), rng.normal(size=2), rng.normal(size=(2, 2)), rng.normal(size=(2, 2)))
    motion_back = values.motion(from_json("/motion", to_json(values.motion_message(motion, 4))))  # type: ignore[arg-type]
    for name in ("shift_px", "shift_sigma_px", "gradient", "gradient_sigma"):
        assert np.array_equal(getattr(motion_back, name), getattr(motion, name))


@settings(max_examples=50)
@given(GRIDS, st.integers(0, 2**31 - 1), st.integers(0, 200), st.integers(0, 255))
def test_maps_come_back_to_the_last_bit_and_damaged_ones_are_refused(grid: Grid, seed: int, at: int, byte: int) -> None:
    disparity = random_map(grid, seed)
    payload = encode_map(disparity)
    back = decode_map(payload)
    assert (back.reference, back.current, back.grid) == (0, seed, grid)
    for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "status"):
        assert np.array_equal(getattr(back, name), getattr(disparity, name))
    with pytest.raises(BadLog):
        decode_map(payload[:-1])
    damaged = bytearray(payload)
    damaged[at % len(payload)] = byte
    with contextlib.suppress(BadLog):
        decode_map(bytes(damaged))


def random_fields(grid: Grid, seed: int) -> tuple[Displacement, StrainField]:
    rng = np.random.default_rng(seed)
    numbers = rng.normal(size=(7, *grid.shape)) * 10.0 ** rng.integers(-12, 6, size=(7, *grid.shape))
    valid = rng.integers(0, 2, (2, *grid.shape)).astype(bool)
    return Displacement(seed, grid, *numbers[:4], valid[0]), StrainField(seed, grid, 9, *numbers[4:], valid[1])


@settings(max_examples=50)
@given(GRIDS, st.integers(0, 2**31 - 1), st.integers(0, 200), st.integers(0, 255))
@example(grid=Grid(0, 0, 1, 1, 5, 1), seed=0, at=91, byte=127)  # a signalling NaN
def test_fields_come_back_within_1e_7_of_themselves_and_damaged_ones_are_refused(grid: Grid, seed: int, at: int, byte: int) -> None:
    displacement, strain = random_fields(grid, seed)
    payloads = encode_displacement(displacement), encode_strain(strain)
    assert [len(payload) for payload in payloads] == [40 + 17 * grid.nx * grid.ny, 40 + 13 * grid.nx * grid.ny]
    moved, strained = decode_displacement(payloads[0]), decode_strain(payloads[1])
    assert (moved.frame, moved.grid) == (seed, grid)
    assert (strained.frame, strained.grid, strained.window_points) == (seed, grid, 9)
    for back, field, names in (
        (moved, displacement, ("u_px", "v_px", "sigma_u_px", "sigma_v_px")),
        (strained, strain, ("exx", "eyy", "exy")),
    ):
        assert np.array_equal(back.valid, field.valid)
        for name in names:
            item, other = getattr(back, name), getattr(field, name)
            assert item.dtype == np.float64
            assert not item.flags.writeable
            assert np.all(np.abs(item - other) <= 1e-7 * np.abs(other))
    # What came back once comes back to the last bit.
    assert (encode_displacement(moved), encode_strain(strained)) == payloads
    for decode, payload in ((decode_displacement, payloads[0]), (decode_strain, payloads[1])):
        with pytest.raises(BadLog):
            decode(payload[:-1])
        damaged = bytearray(payload)
        damaged[at % len(payload)] = byte
        with contextlib.suppress(BadLog):
            decode(bytes(damaged))


def test_a_mask_is_0_or_1_and_one_kind_is_not_read_as_another() -> None:
    displacement, strain = random_fields(Grid(0, 0, 5, 4, 3, 21), 7)
    payloads = encode_map(random_map(displacement.grid, 7)), encode_displacement(displacement), encode_strain(strain)
    with pytest.raises(BadLog, match="/displacement/field: a point has an unknown status"):
        decode_displacement(payloads[1][:-1] + b"\x02")
    for number, decode in enumerate((decode_map, decode_displacement, decode_strain)):
        for other, payload in enumerate(payloads):
            if other != number:
                with pytest.raises(BadLog, match="of version 1; read this log with the version of semlive that wrote it"):
                    decode(payload)


def test_nan_is_refused_and_wall_times_can_be_omitted() -> None:
    with pytest.raises(ValueError, match="finite"):
        DicMessage(reference=0, current=1, points=1, converged=1, mean_u_px=np.nan, mean_v_px=0, noise_px=0, wall_s=1)
    message = DicMessage(reference=0, current=1, points=1, converged=0, mean_u_px=None, mean_v_px=None, noise_px=None, wall_s=1)
    assert b"wall_s" in to_json(message)
    assert b"wall_s" not in to_json(message, wall=False)


@given(st.sampled_from(sorted(TOPICS)), st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
def test_strange_payloads_are_bad_logs(topic: str, payload: bytes) -> None:
    try:
        from_json(topic, payload)
    except BadLog as exc:
        sentence = str(exc)
    else:
        sentence = topic  # a bare object is a valid result
    assert topic in sentence


LINES = st.tuples(st.sampled_from([SEM_ORIGINAL, DIC_MAP, "/log"]), st.binary(max_size=300), st.integers(0, 2**32 - 1))


def write_log(lines: list[tuple[str, bytes, int]], stream: BytesIO, flush_every: int = 1) -> list[LogMessage]:
    writer = LogWriter(stream)
    written = []
    for at, (topic, payload, sequence) in enumerate(lines):
        data = payload
        if topic == "/log":
            data = to_json(LogLineMessage(time_ns=at, level="info", text=payload.hex()))
        writer.write(topic, data, 10 + at, at, sequence)
        written.append(LogMessage(topic, 10 + at, at, sequence, data))
        if at % flush_every == 0:
            writer.flush()
    writer.finish()
    return written


@settings(max_examples=50)
@given(st.lists(LINES, max_size=30), st.integers(1, 5))
def test_logs_are_read_back_completely_and_open_in_the_indexed_reader(lines: list, flush_every: int) -> None:
    stream = BytesIO()
    written = write_log(lines, stream, flush_every)
    damage: list[str] = []
    stream.seek(0)
    assert list(read_messages(stream, damage.append)) == written
    assert damage == []
    stream.seek(0)
    indexed = [(channel.topic, message.data) for _, channel, message in make_reader(stream).iter_messages()]
    assert indexed == [(message.topic, message.payload) for message in written]


@settings(max_examples=100)
@given(st.lists(LINES, min_size=1, max_size=20), st.floats(0, 1, exclude_max=True), st.binary(max_size=40))
def test_truncated_logs_give_all_messages_flushed_before_the_cut(lines: list, fraction: float, rubbish: bytes) -> None:
    stream = BytesIO()
    ends = []
    writer = LogWriter(stream)
    for at, (_, payload, _) in enumerate(lines):
        writer.write(SEM_ORIGINAL, payload, at, at)
        writer.flush()
        ends.append(stream.tell())
    writer.finish()
    whole = stream.getvalue()
    cut = int(8 + fraction * (len(whole) - 8))
    damage: list[str] = []
    read = list(read_messages(BytesIO(whole[:cut] + rubbish), damage.append))
    stored = sum(end <= cut for end in ends)
    assert [message.payload for message in read[:stored]] == [payload for _, payload, _ in lines[:stored]]
    assert [message.sequence for message in read[:stored]] == list(range(stored))
    assert damage or len(read) == len(lines)


def test_one_flipped_bit_costs_one_chunk() -> None:
    stream = BytesIO()
    write_log([("/sem/original", bytes([n]) * 50, n) for n in range(10)], stream)
    data = bytearray(stream.getvalue())
    data[data.index(bytes([4]) * 50) + 7] ^= 1
    damage: list[str] = []
    read = list(read_messages(BytesIO(bytes(data)), damage.append))
    assert [message.sequence for message in read] == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    assert len(damage) == 1


def test_what_is_no_log_is_refused() -> None:
    with pytest.raises(BadLog, match="not an MCAP file"):
        list(read_messages(BytesIO(b"\x89PNG\r\n\x1a\n1234")))


def test_a_message_on_the_wrong_topic_is_refused() -> None:
    writer = LogWriter(BytesIO())
    with pytest.raises(ValueError, match="does not belong"):
        writer.write("/fault", LogLineMessage(time_ns=0, level="info", text=""), 0, 0)
    with pytest.raises(ValueError, match="not a topic"):
        writer.write("/nothing", b"{}", 0, 0)


def test_every_topic_has_a_schema_of_an_object() -> None:
    assert all(json.loads(json_schema(topic))["type"] == "object" for topic in TOPICS)
