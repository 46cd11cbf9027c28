"""Logs and models that are made to exhaust memory or the stack are refused; those of other writers are read."""

from __future__ import annotations

import io
import json
import os
import struct
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from semlive.errors import BadConfig, BadInput, BadLog
from semlive.formats.log.reader import read_messages
from semlive.formats.log.records import MAGIC
from semlive.formats.log.writer import LogWriter
from semlive.formats.metadata.expand import ANY_RATIO_BYTES, expanded
from semlive.inputs.json_text import MOST_NESTED, parse_json
from semlive.report.scoring.truth import load_truth
from semlive.service.diagnosis.model_file import read_model
from semlive.service.log.files import messages
from semlive.service.log.pairs import first_run, topic_counts
from semlive.service.log.repair import recover_segment

HEAD = MAGIC + struct.pack("<BQ", 1, 8) + bytes(8)
DEEP = b"[" * 100_000 + b"]" * 100_000
_BLOCK = bytes(2**24)


def chunk(compression: bytes, data: bytes, stated_bytes: int) -> bytes:
    body = struct.pack("<QQQII", 0, 0, stated_bytes, 0, len(compression)) + compression + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


def zeros(size: int) -> bytes:
    """As zstd, without the size in its head."""
    packing = zstandard.ZstdCompressor().compressobj()
    return b"".join(packing.compress(_BLOCK) for _ in range(size // len(_BLOCK))) + packing.flush()


@pytest.mark.parametrize("stated_bytes", [1000, 2**28, 2**62])
def test_a_chunk_that_expands_without_bound_is_refused_whatever_it_reports_of_its_size(tmp_path: Path, stated_bytes: int) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(HEAD + chunk(b"zstd", zeros(2**28), stated_bytes))
    for look in (lambda: list(messages(path)), lambda: first_run(path), lambda: recover_segment(path, tmp_path / "out.mcap")):
        with pytest.raises(BadLog, match=r"log\.mcap: a chunk of \d+ kB expands to more than 32 MiB"):
            look()
    assert sorted(item.name for item in tmp_path.iterdir()) == ["log.mcap"]


def test_expanding_ends_at_the_bound_for_both_compressions() -> None:
    with pytest.raises(BadLog, match="expands to more than 32 MiB"):
        expanded("zstd", zeros(2**27))
    with pytest.raises(BadLog, match="expands to more than"):
        expanded("lz4", lz4.frame.compress(bytes(2**27)))
    assert expanded("zstd", zeros(ANY_RATIO_BYTES)) == bytes(ANY_RATIO_BYTES)
    # More than that, where the ratio is that of real data.
    real = np.random.default_rng(1).integers(0, 256, ANY_RATIO_BYTES + 2**22, dtype=np.uint8).tobytes()
    assert expanded("zstd", zstandard.compress(real)) == real
    assert expanded("lz4", lz4.frame.compress(real)) == real


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_damaged_compressed_data_is_damage(compression: str) -> None:
    whole = zstandard.compress(b"text" * 1000) if compression == "zstd" else lz4.frame.compress(b"text" * 1000)
    for data in (b"rubbish", whole[:5] + b"\xff" * 20):
        with pytest.raises(ValueError, match=f"damaged {compression} data"):
            expanded(compression, data)
    with pytest.raises(ValueError, match="unknown compression gzip"):
        expanded("gzip", whole)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_a_log_of_another_writer_is_read(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start()
        channel = writer.register_channel("/note", "json", 0)
        for number in range(3000):
            writer.add_message(channel, number, json.dumps({"number": number, "text": "x" * 1000}).encode(), number)
        writer.finish()
    assert [json.loads(item.payload)["number"] for item in messages(path)] == list(range(3000))
    assert topic_counts(path) == {"/note": 3000}


def test_deeply_nested_json_in_a_log_is_an_error_and_can_be_recovered(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = LogWriter(stream)
    writer.write("/run", b'{"config":' + DEEP + b"}", 1, 1)
    writer.flush()
    path = tmp_path / "deep.mcap"
    path.write_bytes(stream.getvalue()[:-50])
    recover_segment(path, tmp_path / "out.mcap")
    path.write_bytes(stream.getvalue())
    with pytest.raises(BadLog, match="recursion limit exceeded"):
        first_run(path)
    assert len(list(read_messages(io.BytesIO(stream.getvalue())))) == 1


def test_the_depth_of_json_is_counted_outside_of_text() -> None:
    assert parse_json('{"a": [1, "' + "[{" * 1000 + '\\"["]}') == {"a": [1, "[{" * 1000 + '"[']}
    assert parse_json("[" * MOST_NESTED + "]" * MOST_NESTED)
    assert len(parse_json(json.dumps([[1, 2]] * 1000))) == 1000
    for text in (DEEP, "[" * (MOST_NESTED + 1) + "]" * (MOST_NESTED + 1), '{"a":' * 5000 + "1" + "}" * 5000):
        with pytest.raises(ValueError, match="nested more than 100 deep"):
            parse_json(text)
    with pytest.raises(ValueError, match="NaN is not a finite number"):
        parse_json('{"a": NaN}')


@pytest.mark.timeout(20)
def test_models_and_truth_are_small_regular_files_of_flat_json(tmp_path: Path) -> None:
    deep, fifo, folder = tmp_path / "deep.json", tmp_path / "fifo.json", tmp_path / "folder.json"
    deep.write_bytes(b'{"version": 1, "effects": ' + DEEP + b"}")
    os.mkfifo(fifo)
    folder.mkdir()
    for path, words in ((deep, "nested more than 100 deep"), (fifo, "not a regular file"), (folder, "it is a folder")):
        with pytest.raises(BadConfig, match=words):
            read_model(path)
        with pytest.raises(BadInput, match=words):
            load_truth(path)
    with pytest.raises(BadLog, match="no such log"):
        first_run(fifo)
