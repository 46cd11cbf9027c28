"""`semlive qualify` on a folder of frames with known drift, shifts and noise: figures, report, file, and a protocol that `plan` takes."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
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


def _write_frames(folder: Path, pairs_px: Sequence[tuple[float, float]] = PAIRS_PX, turned_pairs: int = 0) -> None:
    """Frames of a periodic pattern that moves with the rows as a raster shows it: drift along both axes, shifts, white noise.

    The last pairs have the scan turned by 90 degrees: a shift along x is along y in their frames.
    """
    rng = np.random.default_rng(5)
    pattern = ndimage.gaussian_filter(rng.standard_normal((SIZE_PX, SIZE_PX)), 2.0, mode="wrap")
    spline = ndimage.spline_filter(128.0 + 40.0 * pattern / pattern.std(), mode="grid-wrap")
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX].astype(np.float64)
    lines = ["frame,pair,phase,start_s,dwell_s,row_time_s,width,height,integrations,load_n,shift_x_px,shift_y_px,pixel_nm,rotation_deg"]
    for frame in range(2 * len(pairs_px)):
        shift, start_s = pairs_px[frame // 2], 50.0 * (frame // 2) + 20.5 * (frame % 2)
        turned = frame // 2 >= len(pairs_px) - turned_pairs
        shown = (-shift[1], shift[0]) if turned else shift
        moved = [shown[axis] + RATE_PX_S[axis] * (start_s + ROW_S * y) for axis in (0, 1)]
        image = ndimage.map_coordinates(spline, [y - moved[1], x - moved[0]], prefilter=False, mode="grid-wrap")
        noisy = np.clip(np.rint(image + NOISE_GREY * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)
        tifffile.imwrite(folder / f"frame_{frame}.tif", noisy)
        lines.append(
            f"{frame},{frame // 2},calibration,{start_s},4e-4,{ROW_S},{SIZE_PX},{SIZE_PX},1,,{shift[0]},{shift[1]},10,{90 * turned}"
        )
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
    assert len(pages) == 2
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


def test_pairs_of_a_turned_scan_have_figures_of_their_own(tmp_path: Path, semlive: Call) -> None:
    _write_frames(tmp_path, (*PAIRS_PX[1:], *PAIRS_PX[1:]), turned_pairs=5)
    code, output, errors = semlive("qualify", "--from", tmp_path, "--quick", "--json", "--report", tmp_path / "a.html")
    assert code == 0, errors
    found = json.loads(output)
    (setup,) = found["setups"]
    figures = {figure["name"]: figure for figure in setup["figures"]}
    assert (found["conditions"]["pairs"], setup["pairs"], setup["rotation_deg"]) == (5, 5, 90.0)
    assert figures["drift_rate"]["low"] <= float(np.hypot(*RATE_PX_S)) <= figures["drift_rate"]["high"]
    for name, true in (("scan_turn_error", 0.0), ("pixel_size_ratio", 1.0), ("scan_aspect", 1.0), ("scan_shear", 0.0)):
        assert figures[name]["low"] <= true <= figures[name]["high"], name
    missing = {item["name"] for item in found["undetermined"]}
    assert ("magnification" in missing, "scan_axes" in missing) == (True, False)
    assert "scan turned by 90" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_a_wrong_request_is_refused(frames: Path, tmp_path: Path, semlive: Call) -> None:
    for given, reason in (
        ((), "give CONFIG of the instrument"),
        (("--from", tmp_path), "contains 0 images"),
        (("--history", frames), "needs at least two"),
        (("--history", frames, "--follow"), "--follow needs --from LOG"),
        (("--from", frames, "--follow"), "is not the folder of a log"),
        (("--from", frames, "--from", frames, "--follow"), "and no other"),
        (("--from", frames, "--step", "turned"), "--step needs CONFIG"),
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


def test_slow_frames_have_fewer_pairs_and_a_further_step_has_its_own_scan(tmp_path: Path, semlive: Call) -> None:
    given, planned = tmp_path / "lab.yaml", tmp_path / "qualifying.yaml"
    text = "sem: {folder: export, pixel_size_um: 0.1, profile: {frame_time_s: %g}}\nprotocol: {calibration_shifts_px: [[0, 0]], hold_s: 5}"
    for frame_s, pairs, warms_up in ((1, 10, True), (40, 10, True), (60, 10, False), (90, 6, False)):
        given.write_text(text % frame_s, encoding="utf-8")
        code, output, errors = semlive("qualify", given, "--protocol", planned)
        assert (code, output.count(f" {pairs} pairs, about")) == (0, 1), output + errors
        rule = load_config(planned).plan().warm_up
        assert (rule is not None, "until the drift has settled" in output) == (warms_up, warms_up)
        minutes = [int(part.split()[0]) for part in (output.split("about ")[1], output.split("up to ")[1] if warms_up else "0")]
        assert sum(minutes) <= 30
        if rule is not None:
            assert (rule.max_change_px_s, rule.continue_after_wait) == (pytest.approx(0.02 / frame_s, rel=0.01), True)
    for step, change, frame_s, pixel_um in (
        ("rows", "half of the rows", 45, 0.1), ("dwell", "set 0.5 times the dwell time", 45, 0.1), ("turned", "by 90 degrees", 90, 0.1),
        ("magnified", "double the magnification", 90, 0.05),
    ):  # fmt: skip
        code, output, errors = semlive("qualify", given, "--step", step, "--protocol", planned)
        assert (code, change in output) == (0, True), output + errors
        config = load_config(planned)
        assert (config.sem.profile.frame_time_s, config.sem.pixel_size_um) == (frame_s, pixel_um)
        assert config.stage is not None
        assert config.stage.settings["um_per_px"] == pixel_um
        assert config.run.name == f"run-{step}"


def test_a_further_step_adds_its_figures_to_those_of_the_first(frames: Path, tmp_path: Path, semlive: Call) -> None:
    _write_frames(tmp_path, PAIRS_PX[1:], turned_pairs=5)
    code, output, errors = semlive("qualify", "--from", frames, "--from", tmp_path, "--quick", "--json")
    assert code == 0, errors
    found = json.loads(output)
    (setup,) = found["setups"]
    assert (found["conditions"]["pairs"], setup["pairs"], setup["rotation_deg"], setup["height_px"]) == (6, 5, 90.0, SIZE_PX)
    assert "scan_aspect" in {figure["name"] for figure in setup["figures"]}
    assert "scan_axes" not in {item["name"] for item in found["undetermined"]}
    code, output, errors = semlive("qualify", "--from", frames, "--quick")
    assert (code, "semlive qualify CONFIG --step rows --protocol rows.yaml" in output) == (0, True), output + errors
