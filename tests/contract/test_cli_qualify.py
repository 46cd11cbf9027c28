"""`semlive qualify` on a folder of frames with known drift, shifts and noise: figures, report, file, and a protocol that `plan` takes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from pypdf import PdfReader
from scipy import ndimage

from semlive.service.config.configuration import load_config

SIZE_PX, PAIRS_PX = 200, ((0.0, 0.0), (0.0, 0.0), (8.0, 0.0), (-8.0, 0.0), (0.0, 8.0), (0.0, -8.0))
RATE_PX_S, FRAME_S, NOISE_GREY = np.array([0.012, -0.02]), 20.0, 6.0
ROW_S = FRAME_S / SIZE_PX
Call = Callable[..., tuple[int, str, str]]


def _write_frames(folder: Path) -> None:
    """Frames of a periodic pattern that moves with the rows as a raster shows it: drift along both axes, shifts, white noise."""
    rng = np.random.default_rng(5)
    pattern = ndimage.gaussian_filter(rng.standard_normal((SIZE_PX, SIZE_PX)), 2.0, mode="wrap")
    spline = ndimage.spline_filter(128.0 + 40.0 * pattern / pattern.std(), mode="grid-wrap")
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX].astype(np.float64)
    lines = ["frame,pair,phase,start_s,dwell_s,row_time_s,width,height,integrations,load_n,shift_x_px,shift_y_px,pixel_nm"]
    for frame in range(2 * len(PAIRS_PX)):
        shift, start_s = PAIRS_PX[frame // 2], 50.0 * (frame // 2) + 20.5 * (frame % 2)
        moved = [shift[axis] + RATE_PX_S[axis] * (start_s + ROW_S * y) for axis in (0, 1)]
        image = ndimage.map_coordinates(spline, [y - moved[1], x - moved[0]], prefilter=False, mode="grid-wrap")
        noisy = np.clip(np.rint(image + NOISE_GREY * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)
        tifffile.imwrite(folder / f"frame_{frame}.tif", noisy)
        lines.append(f"{frame},{frame // 2},calibration,{start_s},4e-4,{ROW_S},{SIZE_PX},{SIZE_PX},1,,{shift[0]},{shift[1]},10")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("frames")
    _write_frames(folder)
    return folder


def test_a_folder_is_qualified(frames: Path, tmp_path: Path, semlive: Call) -> None:
    names = (("-o", "a.json"), ("--report", "a.html"), ("--pdf", "a.pdf"), ("--protocol", "a.yaml"))
    files = {option: tmp_path / name for option, name in names}
    given = [part for option, path in files.items() for part in (option, path)]
    code, output, errors = semlive("qualify", "--from", frames, "--quick", "--json", *given)
    assert code == 0, errors
    found = json.loads(output)
    assert found == json.loads(files["-o"].read_text(encoding="utf-8"))
    figures = {figure["name"]: figure for figure in found["figures"]}
    rate = figures["drift_rate"]
    assert rate["low"] <= float(np.hypot(*RATE_PX_S)) <= rate["high"]
    assert figures["drift_rate_nm"]["value"] == pytest.approx(10.0 * rate["value"])
    assert figures["frame_interval"]["value"] == pytest.approx(20.5 / FRAME_S, abs=1e-3)
    assert figures["stage_rotation"]["low"] <= 0.0 <= figures["stage_rotation"]["high"]
    assert figures["stage_scale_x"]["low"] <= 1.0 <= figures["stage_scale_x"]["high"]
    missing = {item["name"] for item in found["undetermined"]}
    assert {"drift_decay", "further_effects"} <= missing
    pages = PdfReader(files["--pdf"]).pages
    text = " ".join(" ".join(page.extract_text() for page in pages).split())
    assert found["limits"][0]["remedy"] in text
    assert 1 <= len(pages) <= 6
    code, planned, errors = semlive("plan", files["--protocol"], "--json")
    assert code == 0, errors
    assert json.loads(planned)["pairs"] == len(found["protocol"]["shifts_px"])


def test_frames_without_times_give_no_rate(frames: Path, tmp_path: Path, semlive: Call) -> None:
    for name in ("frame_0.tif", "frame_1.tif"):
        (tmp_path / name).write_bytes((frames / name).read_bytes())
    code, output, errors = semlive("qualify", "--from", tmp_path, "--quick", "--json")
    assert code == 0, errors
    found = json.loads(output)
    figures = {figure["name"]: figure for figure in found["figures"]}
    true_px = 20.5 * float(np.hypot(*RATE_PX_S))
    assert figures["drift_in_frame"]["low"] <= true_px <= figures["drift_in_frame"]["high"]
    assert "drift_rate" not in figures
    assert {"drift_rate", "frame_interval", "distortion", "stage"} <= {item["name"] for item in found["undetermined"]}


def test_a_wrong_request_is_refused(frames: Path, tmp_path: Path, semlive: Call) -> None:
    for given, reason in (
        ((), "give CONFIG of the instrument"),
        (("--from", tmp_path), "contains 0 images"),
        (("--history", frames), "needs at least two"),
        (("--history", frames, "--follow"), "--follow needs --from LOG"),
        (("--from", frames, "--follow"), "is not the folder of a log"),
    ):
        code, _, errors = semlive("qualify", *given)
        assert (code, reason in errors) == (2, True), errors


def test_the_qualifying_run_needs_no_load_frame(tmp_path: Path, semlive: Call) -> None:
    given, planned = tmp_path / "lab.yaml", tmp_path / "qualifying.yaml"
    assert semlive("init", given, "--lab", "operator-deben", "--yes")[0] == 0
    code, _, errors = semlive("qualify", given, "--protocol", planned)
    assert code == 0, errors
    config = load_config(planned)
    assert (config.load_frame, config.protocol.loads_n) == (None, [])
    assert config.limits == load_config(given).limits  # travel of the stage, and age of its readings
    largest = max(abs(x) for x, _ in load_config(given).protocol.calibration_shifts_px)
    shifts = config.protocol.calibration_shifts_px
    assert shifts[:4] == [(0.0, 0.0)] * 4
    assert max(x for x, _ in shifts) == largest == -min(y for _, y in shifts)
    assert config.sem.folder == load_config(given).sem.folder


def test_an_instrument_may_have_no_load_frame_and_no_stage(tmp_path: Path, semlive: Call) -> None:
    given, planned = tmp_path / "lab.yaml", tmp_path / "qualifying.yaml"
    for stage in ("", "stage: {driver: operator}\nlimits: {stage_travel_um: 50}\n"):
        text = "sem: {folder: export, pixel_size_um: 0.1}\nprotocol: {calibration_shifts_px: [[0, 0]]}\n" + stage
        given.write_text(text, encoding="utf-8")
        code, _, errors = semlive("qualify", given, "--protocol", planned)
        assert code == 0, errors
        config = load_config(planned)
        assert (config.load_frame, config.stage and config.stage.driver, config.plan().limits.stage_travel_um) == (
            None, "operator", 50 if stage else 1000,
        )  # fmt: skip
