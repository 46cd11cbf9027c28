"""Region and masks of `semlive init`: the default from the size of the frame, the terminal, and the server of the page."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.cli.before_run.region.drawing import Drawing, FrameSize, default_region, mask_png, parse_region
from semlive.cli.before_run.region.question import region_answer
from semlive.cli.before_run.region.server import RegionServer
from semlive.errors import BadConfig, BadInput
from semlive.service.config.configuration import load_config

SIZE = FrameSize(320, 240, 43)


@pytest.fixture
def frame(tmp_path: Path) -> Path:
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), np.random.default_rng(1).integers(0, 255, (240, 320), dtype=np.uint8))
    return path


@pytest.fixture
def server() -> Iterator[RegionServer]:
    with RegionServer(np.zeros((240, 320), dtype=np.uint16), SIZE, default_region(SIZE)) as running:
        yield running


def request(server: RegionServer, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, bytes]:
    address = urlsplit(server.address)
    sent = {"authorization": f"Bearer {address.fragment}", **{name.replace("_", "-"): value for name, value in headers.items()}}
    connection = http.client.HTTPConnection("127.0.0.1", address.port or 0, timeout=20)
    connection.request(method, path, body, sent)
    reply = connection.getresponse()
    content = reply.read()
    connection.close()
    return reply.status, content


def written(folder: Path, *arguments: object, typed: str | None = None) -> Any:
    return CliRunner().invoke(app, ["init", str(folder / "run.yaml"), *map(str, arguments)], input=typed)


def test_the_default_region_has_a_margin_for_the_shifts_of_the_calibration() -> None:
    assert default_region(SIZE) == (61, 61, 258, 178)
    assert default_region(FrameSize(60, 60, 43)) == (25, 25, 34, 34)
    with pytest.raises(BadInput, match="a frame of 40 x 60 px is smaller than a subset of 43 px"):
        default_region(FrameSize(40, 60, 43))


@pytest.mark.parametrize("text", ["1,2,3", "a,b,c,d", "9,9,8,10", "0,0,320,100", "-1,0,5,5"])
def test_a_wrong_region_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match=r"^region "):
        parse_region(text, SIZE)


def test_the_mask_is_zero_where_it_was_drawn() -> None:
    drawing = Drawing(region_px=(0, 0, 9, 9), masks_px=(((10.2, 20.0), (30.0, 20.0), (30.0, 40.0), (10.0, 40.0)),))
    mask = cv2.imdecode(np.frombuffer(mask_png(drawing, SIZE), np.uint8), cv2.IMREAD_UNCHANGED)
    assert mask is not None
    assert mask.shape == (240, 320)
    assert set(np.unique(mask)) == {0, 255}
    assert not mask[20:41, 10:31].any()
    assert np.count_nonzero(mask == 0) == 21 * 21


def test_init_takes_the_region_from_the_size_of_the_frame(tmp_path: Path, frame: Path) -> None:
    done = written(tmp_path, "--yes", "--test-frame", frame, "--json")
    assert done.exit_code == 0, done.output
    assert load_config(tmp_path / "run.yaml").dic.roi_px == (61, 61, 258, 178)


def test_without_a_browser_four_numbers_are_typed_and_wrong_ones_are_requested_again(tmp_path: Path, frame: Path) -> None:
    done = written(tmp_path, "--test-frame", frame, "--no-draw", typed="\n\n\n\nnone\n\n\n1,2\n30, 30, 200, 150\n")
    assert done.exit_code == 0, done.output
    assert "give four whole numbers" in done.output
    assert load_config(tmp_path / "run.yaml").dic.roi_px == (30, 30, 200, 150)


def test_a_region_needs_a_frame(tmp_path: Path) -> None:
    assert isinstance(written(tmp_path, "--yes", "--region", "1,2,3,4").exception, BadConfig)


def test_a_drawing_is_the_answer(frame: Path) -> None:
    def draws(address: str) -> None:
        place = urlsplit(address)
        connection = http.client.HTTPConnection("127.0.0.1", place.port or 0, timeout=20)
        body = json.dumps({"region_px": [30, 30, 99, 98], "masks_px": [[[0, 0], [5, 0], [5, 5]]]})
        connection.request("POST", "/drawing", body, {"authorization": f"Bearer {place.fragment}"})
        assert connection.getresponse().status == 200

    answer = region_answer(frame, None, True, False, draws)
    assert answer.region_px == (30, 30, 99, 98)
    assert answer.mask is not None
    assert answer.mask.startswith(b"\x89PNG")


def test_the_region_can_stay_unchanged(server: RegionServer) -> None:
    assert request(server, "POST", "/keep")[0] == 200
    assert server.answer(5.0) is None


@pytest.mark.parametrize(
    ("method", "path", "body", "headers", "status"),
    [
        ("GET", "/", b"", {"authorization": ""}, 200),
        ("GET", "/frame.png", b"", {"authorization": ""}, 403),
        ("GET", "/frame.json", b"", {"authorization": "Bearer wrong"}, 403),
        ("GET", "/../server.py", b"", {}, 404),
        ("GET", "/", b"", {"host": "evil.example"}, 421),
        ("POST", "/drawing", b"{}", {"authorization": ""}, 403),
        ("POST", "/drawing", b"{}", {"host": "evil.example"}, 421),
        ("POST", "/drawing", b"{}", {}, 400),
        ("POST", "/drawing", b'{"region_px": [0, 0, 900, 9]}', {}, 400),
        ("POST", "/drawing", b'{"region_px": [0, 0, 9, 9], "masks_px": [[[0, 0]]]}', {}, 400),
        ("POST", "/drawing", b'{"region_px": [0, 0, 9, 9], "more": 1}', {}, 400),
        ("POST", "/drawing", b"", {"content_length": "99999999"}, 413),
        ("POST", "/else", b"", {}, 404),
    ],
)
def test_others_get_nothing_and_change_nothing(
    server: RegionServer, method: str, path: str, body: bytes, headers: dict[str, str], status: int
) -> None:
    assert request(server, method, path, body, **headers)[0] == status
    with pytest.raises(TimeoutError):
        server.answer(0.01)


def test_a_sixteen_bit_frame_is_shown_with_eight(server: RegionServer) -> None:
    status, data = request(server, "GET", "/frame.png")
    shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert status == 200
    assert shown is not None
    assert (shown.shape, shown.dtype) == ((240, 320), np.uint8)
