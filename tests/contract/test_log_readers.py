"""Others read our logs: the mcap library, JSON Schema, protobuf, foxglove-sdk, @mcap/core, and viewers by their own rules."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from read_by_others import Validator, by_node, check_messages, counts, node_modules, viewers_understand

from semlive.data.disparity import DisparityMap
from semlive.data.drift import DistortionField, DriftEstimate, EstimateRevision
from semlive.data.experiment import Phase, Step
from semlive.data.frame import Frame, FrameInfo
from semlive.data.grid import Grid
from semlive.data.pair import Pair, PairDecision
from semlive.data.results import FrameResult, PairResult
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.strain import Displacement, ElasticConstants, MeasuredValue, StrainField, StrainSummary, Tensor2
from semlive.formats.log import conversions as values
from semlive.formats.log.foxglove import IMAGE_TOPICS, SEM_IMAGE
from semlive.formats.log.messages import (
    RAW_TOPICS,
    TOPICS,
    LogLineMessage,
    OperatorMessage,
    Payload,
    RunMessage,
    StateMessage,
    from_json,
    schema_of,
    to_json,
    topic_of,
)
from semlive.formats.log.reader import LogMessage
from semlive.formats.log.writer import LogWriter
from semlive.service.analysis.preview_images import preview_images
from semlive.service.analysis.results import result_messages

GRID = Grid(20, 30, 5, 12, 9, 21)
END_NS = 1_763_732_636_814_000_001


def frame(export: int, dtype: type[np.uint8] | type[np.uint16] = np.uint8) -> Frame:
    timing = ScanTiming(*(Sourced(value, Provenance.FILE) for value in (1e-6, 1e-4, 0.01)), Sourced(1, Provenance.FILE))
    start = Sourced(END_NS - 10_000_000, Provenance.DERIVED)
    info = FrameInfo(export, f"{export}.tif", "fei", 90, 70, 0, timing, start, 0.5, Sourced(1e-7, Provenance.CONFIG))
    pixels = np.random.default_rng(export).integers(0, np.iinfo(dtype).max, (70, 90), dtype=dtype)
    return Frame(info, pixels)


def disparity(reference: int, current: int) -> DisparityMap:
    u, v, sigma_u, sigma_v, zncc = np.random.default_rng(current).normal(size=(5, *GRID.shape))
    status = np.zeros(GRID.shape, np.uint8)
    status[3, 4] = 2
    return DisparityMap(reference, current, GRID, u, v, sigma_u, sigma_v, zncc, status)


def strain(number: int) -> StrainField:
    exx, eyy, exy = np.random.default_rng(number).normal(size=(3, *GRID.shape)).astype(np.float32).astype(np.float64)
    return StrainField(number, GRID, 9, exx, eyy, exy, np.ones(GRID.shape, bool))


def as_message(payload: Payload) -> LogMessage:
    return LogMessage(topic_of(payload), END_NS, END_NS, 0, to_json(payload))


FRAMES = (frame(7), frame(9, np.uint16))
PAIR = PairDecision(1, Step(1, Phase.TENSION, (0.0, 0.0), (0.0, 0.0), 100.0), FRAMES[0].info, FRAMES[1].info, None)


def corrected(number: int) -> FrameResult:
    u, v, sigma_u, sigma_v = np.random.default_rng(number).normal(size=(4, *GRID.shape))
    tensor = Tensor2(1e-3, 2e-3, 3e-3)
    displacement = Displacement(number, GRID, u, v, sigma_u, sigma_v, np.ones(GRID.shape, bool))
    return FrameResult(displacement, strain(number), StrainSummary(number, tensor, tensor, tensor, 83.0, None))


def analysed() -> PairResult:
    """The results of a pair, with an earlier frame that was corrected again."""
    rng = np.random.default_rng(0)
    drift = DriftEstimate(rng.normal(size=5), np.arange(5), *rng.normal(size=(3, 5, 2)), revision=2)
    distortion = DistortionField(GRID, *rng.normal(size=(3, *GRID.shape)), np.ones(GRID.shape, bool))
    estimate = EstimateRevision(drift, distortion, (), 0.01, ())
    elastic = ElasticConstants(MeasuredValue(71.0, 0.1), MeasuredValue(0.33, 0.01))
    maps = (disparity(2, 3), disparity(0, 2), disparity(0, 3))
    return PairResult(PAIR, 2, maps, estimate, (corrected(2), corrected(3)), elastic, None, (corrected(0),))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.000.mcap"
    pair = as_message(values.pair_message(PAIR))
    started = RunMessage(run="run", started_time_ns=1, host="lab", boot_id="b", versions={"semlive": "1"}, config={"a": None})
    state = StateMessage(time_ns=1, before="idle", after="connecting", cause="opening", step=None, guards={"force_n": 1.5})
    printed = [
        started,
        state,
        LogLineMessage(time_ns=END_NS, level="warning", text="hot"),
        OperatorMessage(time_ns=1, what="start", args={}),
    ]
    with path.open("wb") as stream:
        writer = LogWriter(stream)
        result = analysed()
        unknown = as_message(values.elastic_message(None, 2))
        made = [unknown, *result_messages(result, 0.1), *preview_images(Pair(PAIR, *FRAMES), result)]
        for at, item in enumerate([*map(as_message, printed), pair, *made]):
            writer.write(item.topic, item.payload, END_NS + at, item.publish_time_ns, item.sequence if item.topic in RAW_TOPICS else None)
            writer.flush()
        writer.finish()
    return path


@pytest.mark.parametrize("topic", sorted(TOPICS))
def test_every_schema_is_one_and_viewers_understand_it(topic: str) -> None:
    named = schema_of(topic)
    assert named is not None
    schema = json.loads(named[2])
    Draft202012Validator.check_schema(schema)
    viewers_understand(schema, topic)


@pytest.mark.parametrize("kind", ["boolean", "string", "number", "integer", "object"])
def test_arrays_that_are_validated_at_once_get_the_verdict_of_json_schema(kind: str) -> None:
    for schema in ({"items": {"type": kind}}, {"items": {"type": kind, "minimum": 2}}, {"prefixItems": [{}], "items": {"type": kind}}):
        for value in ([1, 2.5], [True, False], [1, None], ["x"], [], [1.0], [True, 1], [[1]], {"1": 1}, None):
            plain, ours = (sorted(map(str, one(schema).iter_errors(value))) for one in (Draft202012Validator, Validator))
            assert ours == plain


def test_payloads_fit_their_schemas_and_foxglove_encodes_the_same_images(log: Path) -> None:
    newest = check_messages(log)
    assert newest["/drift/estimate"]["x_px"] == newest["/drift/estimate"]["drift_px"][-1][0]
    assert newest["/elastic"]["youngs_modulus_gpa"]["value"] == 71.0


def test_images_are_lossless_and_fields_are_shown_to_the_last_bit(log: Path) -> None:
    shown: dict[str, dict[int, Any]] = {}
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=list(IMAGE_TOPICS)):
            shown.setdefault(channel.topic, {})[message.sequence] = decoded
    assert {topic: sorted(found) for topic, found in shown.items()} == {
        SEM_IMAGE: [7, 9],
        "/dic/image/u": [2, 3],
        "/dic/image/v": [2, 3],
        "/dic/pair_image/u": [3],
        "/dic/pair_image/v": [3],
        "/distortion/image/x": [2],
        "/distortion/image/y": [2],
        "/strain/image/exx": [2, 3],
        "/strain/image/eyy": [2, 3],
        "/strain/image/exy": [2, 3],
    }
    for item in FRAMES:
        image = shown[SEM_IMAGE][item.info.export]
        pixels = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert pixels is not None
        assert pixels.dtype == item.image.dtype
        assert np.array_equal(pixels, item.image)
        assert image.timestamp.seconds * 10**9 + image.timestamp.nanos == item.info.end_time_ns
    exy = shown["/strain/image/exy"][3]
    assert np.array_equal(np.frombuffer(exy.data, "<f4").reshape(exy.height, exy.width), strain(3).exy.astype(np.float32))
    u = np.frombuffer(shown["/dic/image/u"][2].data, "<f4").reshape(GRID.shape)
    assert np.isnan(u[3, 4])
    assert np.isnan(u).sum() == 1


def test_a_pair_that_could_not_be_analysed_is_shown_all_the_same() -> None:
    assert [item.topic for item in preview_images(Pair(PAIR, *FRAMES), None)] == [SEM_IMAGE, SEM_IMAGE]


def test_lines_of_the_log_are_foxglove_s_and_older_ones_are_still_read(log: Path) -> None:
    payload = json.loads(to_json(LogLineMessage(time_ns=END_NS, level="warning", text="hot")))
    assert (payload["level"], payload["message"], payload["timestamp"]) == (3, "hot", {"sec": 1_763_732_636, "nsec": 814_000_001})
    older = from_json("/log", b'{"level":"warning","text":"hot","time_ns":5}')
    assert older == LogLineMessage(time_ns=5, level="warning", text="hot")
    with log.open("rb") as stream:
        assert {schema.name for schema, *_ in make_reader(stream).iter_messages(topics=["/log"]) if schema} == {"foxglove.Log"}


def test_a_run_is_described_in_the_metadata(log: Path) -> None:
    with log.open("rb") as stream:
        [metadata] = make_reader(stream).iter_metadata()
    assert metadata.name == "semlive.run"
    assert metadata.metadata["boot_id"] == "b"
    assert json.loads(metadata.metadata["config"]) == {"a": None}


@pytest.fixture
def node_peer() -> Path:
    """Where @mcap/core is installed."""
    modules = node_modules()
    if modules is None:
        pytest.skip("@mcap/core is not there: SEMLIVE_NODE_MODULES names no folder, or there is no node")
    return modules


def test_the_reader_for_javascript_finds_the_same(log: Path, node_peer: Path) -> None:
    read = by_node(log, node_peer)
    assert read["counts"] == counts(log)
    assert read["metadata"] == ["semlive.run"]


@pytest.mark.checkout
def test_the_layout_that_is_installed_is_the_one_that_is_deployed() -> None:
    root = Path(__file__).resolve().parents[2]
    assert (root / "deploy/foxglove-layout.json").read_bytes() == (root / "semlive/service/foxglove-layout.json").read_bytes()
