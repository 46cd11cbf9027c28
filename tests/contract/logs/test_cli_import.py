"""`semlive import`: a folder becomes a log that every other command takes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numexp.asfolder import write_folder
from numexp.cases import CASES
from numexp.experiment import Experiment, make_experiment

from semlive.data.grid import Grid
from semlive.errors import BadInput
from semlive.formats.log.conversions import pair_decision
from semlive.formats.log.maps import decode_map
from semlive.formats.log.messages import DIC_MAP, PairMessage, from_json
from semlive.service.analysis.result_json import result_json
from semlive.service.diagnosis.run import load_observation
from semlive.service.log.files import messages
from semlive.service.log.opened_log import OpenedLog
from semlive.service.replay.import_maps import ImportRequest, import_folder
from semlive.service.replay.replay import ReplayRequest, replay

Semlive = Callable[..., tuple[int, str, str]]


def test_the_command_writes_a_log_and_prints_one_json_object(semlive: Semlive, folder: Path, tmp_path: Path) -> None:
    log = tmp_path / "brought.mcap"
    code, out, err = semlive("import", str(folder), "-o", str(log), "--specimen-area-mm2", "1.0", "--loading-axis", "y", "--json")
    assert (code, err) == (0, "")
    printed = json.loads(out)
    assert printed["pairs"] == 12
    assert printed["maps"] == 23
    subset_px = printed["grid"].pop("subset_px")
    assert printed["grid"] == {"x0_px": 101, "y0_px": 101, "step_px": 25, "nx": 30, "ny": 24}
    assert subset_px == pytest.approx(43, abs=6)  # of the noise in the maps, which do not state it
    assert (printed["noise"]["subset_px"], printed["noise"]["source"], printed["noise"]["maps"]) == (subset_px, "estimated", 6)
    assert printed["from"] == ["semlive"]
    assert log.is_file()
    assert list(tmp_path.iterdir()) == [log]


def test_maps_stand_in_the_log_as_they_were_listed(imported: Path, experiment: Experiment) -> None:
    found = {(m.reference, m.current): m for m in (decode_map(one.payload) for one in messages(imported) if one.topic == DIC_MAP)}
    given = {(m.reference, m.current): m for taken in experiment.pairs for m in taken.maps}
    assert found.keys() == {key for key in given if key[0] or key[1] % 2 == 0 or key[1] == 1}
    for key, one in found.items():
        np.testing.assert_allclose(one.u_px, given[key].u_px, atol=5e-10)
        np.testing.assert_allclose(one.v_px, given[key].v_px, atol=5e-10)


def test_strain_and_elastic_constants_come_out_right(imported: Path, experiment: Experiment) -> None:
    done = replay(ReplayRequest(imported))
    expected = result_json(done.result, done.settings)
    assert expected["pairs"] == 12
    assert expected["vsg_px"] == 8 * 25
    assert expected["window_px"] == 9 * 25
    modulus, ratio = expected["elastic"]["youngs_modulus_gpa"], expected["elastic"]["poissons_ratio"]
    assert abs(modulus["value"] - 71.1) < 4 * modulus["sigma"] < 4.0
    assert abs(ratio["value"] - 0.33) < 4 * ratio["sigma"] < 0.1
    for frame in expected["frames"]:
        truth = experiment.pairs[frame["pair"]].observed[-1].gradient
        assert abs(frame["strain_mean"]["eyy"] - truth[1, 1]) < 5 * frame["strain_mean_sigma"]["eyy"] + 1e-6
    assert [frame["frame"] for frame in expected["frames"]] == list(range(24))


def test_maps_from_frame_0_to_second_frames_are_taken_too(experiment: Experiment, tmp_path: Path) -> None:
    few = make_experiment(CASES["exact"], 5, Grid(101, 101, 50, 15, 12, 0), calibration_pairs=3)
    whole = import_folder(ImportRequest(write_folder(few, tmp_path / "whole", seconds=True), tmp_path / "whole.mcap"))
    assert whole.maps == 1 + 2 * 3
    results = []
    for name in ("whole", "less"):
        if name == "less":
            import_folder(ImportRequest(write_folder(few, tmp_path / "less"), tmp_path / "less.mcap"))
        results.append(replay(ReplayRequest(tmp_path / f"{name}.mcap")).result)
    for one, other in zip(*(result.frames for result in results), strict=True):
        both = one.displacement.valid & other.displacement.valid
        assert both.mean() > 0.5
        # Composed of two maps by bilinear interpolation over 50 px of bent raster.
        assert np.abs(one.displacement.u_px - other.displacement.u_px)[both].max() < 0.05


def test_an_imported_log_goes_through_report_and_score(semlive: Semlive, imported: Path, tmp_path: Path) -> None:
    code, _, err = semlive("report", str(imported), "-o", str(tmp_path / "page.html"))
    assert code == 0
    assert all(line.startswith("drawing: ") for line in err.splitlines()), err  # printed on a busy computer alone
    assert "Maps of another engine, step 25 px" in (tmp_path / "page.html").read_text()


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def refused(folder: Path, log: str = "log.mcap") -> str:
    with pytest.raises(BadInput) as wrong:
        import_folder(ImportRequest(folder, folder.parent / log))
    assert not list(folder.parent.glob("*.part"))
    assert "\n" not in str(wrong.value)
    return str(wrong.value)


def test_a_missing_map_is_named(copy: Path) -> None:
    (copy / "disparity_0_8.csv").unlink()
    assert refused(copy) == (
        "disparity_0_8.csv: is missing, but it determines the motion of the pair; add it, or take the frames of pair 4 out of frames.csv."
    )


def test_a_missing_table_of_frames_is_named(copy: Path) -> None:
    (copy / "frames.csv").unlink()
    assert "frames.csv: is missing; write it as docs/how-to/import.md shows." in refused(copy)
    assert "no such folder" in refused(copy / "nowhere")


def test_unequal_grids_are_reported_with_their_first_difference(copy: Path) -> None:
    path = copy / "disparity_0_8.csv"
    path.write_text(path.read_text().replace("\n101,", "\n100,"))
    assert "disparity_0_8.csv: line 2, column x: 100 is not on the grid of the first map (101, 126, ... 826)" in refused(copy)


def test_a_map_without_a_valid_point_is_refused(copy: Path) -> None:
    path = copy / "disparity_8_9.csv"
    head, *lines = path.read_text().split()
    path.write_text("\n".join([head, *(line.removesuffix("1") + "0" for line in lines)]))
    assert refused(copy).startswith("disparity_8_9.csv: no point is valid")


def test_what_an_import_did_not_write_is_never_overwritten(copy: Path) -> None:
    mine = copy.parent / "log.mcap"
    mine.write_bytes(b"mine")
    assert "exists and was not written by an import" in refused(copy)
    assert mine.read_bytes() == b"mine"
    mine.unlink()
    for _ in range(2):
        import_folder(ImportRequest(copy, mine))


def test_maps_of_other_pairs_are_omitted_and_reported(copy: Path) -> None:
    shutil.copy(copy / "disparity_0_8.csv", copy / "disparity_3_8.csv")
    assert import_folder(ImportRequest(copy, copy.parent / "log.mcap")).skipped == ("disparity_3_8.csv",)


def test_import_logs_the_clock_and_the_pixel_size(copy: Path) -> None:
    """The clock has the times of equations 1 to 4 before a pause in frame 3, and later ones after it."""
    frames = (copy / "frames.csv").read_text().splitlines()
    (copy / "frames.csv").write_text("\n".join([frames[0] + ",pixel_nm", *(line + ",1250" for line in frames[1:])]) + "\n")
    row_time_s = float(frames[1].split(",")[frames[0].split(",").index("row_time_s")])
    starts = [row * row_time_s + 7.0 * (row >= 400) for row in range(884)]
    (copy / "clock_3.csv").write_text("\n".join(["row_start_s", *map(repr, starts)]) + "\n")
    log = copy.parent / "log.mcap"
    import_folder(ImportRequest(copy, log))
    logged = [from_json(one.topic, one.payload) for one in messages(log) if one.topic == "/pair"]
    pairs = [pair_decision(one) for one in logged if isinstance(one, PairMessage)]
    clocks = {info.export: info.timing.clock for pair in pairs for info in (pair.first, pair.second)}
    assert {frame for frame, clock in clocks.items() if clock is not None} == {3}
    timing = pairs[1].second.timing
    nominal = replace(timing, clock=None)
    assert timing.time_in_frame_s(10.0, 399.0) == pytest.approx(nominal.time_in_frame_s(10.0, 399.0), abs=1e-9)
    assert timing.time_in_frame_s(10.0, 400.0) == pytest.approx(nominal.time_in_frame_s(10.0, 400.0) + 7.0, abs=1e-9)
    assert pairs[0].first.pixel_size_m.value == pytest.approx(1.25e-6)


def test_a_clock_of_another_frame_size_is_refused(copy: Path) -> None:
    (copy / "clock_3.csv").write_text("row_start_s\n0\n0.1\n")
    assert refused(copy).startswith("clock_3.csv: holds 2 rows, and the frame has 884")


def test_images_cannot_be_replayed_where_there_are_none(semlive: Semlive, imported: Path) -> None:
    code, out, err = semlive("replay", str(imported), "--from-images", "--json")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "holds no images" in err


def test_the_source_of_the_noise_correlation_is_printed_and_stored(semlive: Semlive, folder: Path, tmp_path: Path) -> None:
    log = tmp_path / "given.mcap"
    code, out, _ = semlive("import", str(folder), "-o", str(log), "--subset-px", "31")
    assert code == 0
    assert "correlated over 31 px, as given with --subset-px" in " ".join(out.split())
    config = next(json.loads(one.payload)["config"] for one in messages(log) if one.topic == "/run")
    assert config["imported"]["noise"] == {
        "subset_px": 31,
        "source": "given",
        "edge_px": None,
        "sigma_px": None,
        "gaussian": None,
        "own_fraction": None,
        "maps": 0,
    }


def test_the_hold_before_the_pairs_is_stored_or_stated_to_be_assumed(semlive: Semlive, folder: Path, tmp_path: Path) -> None:
    code, out, _ = semlive("import", str(folder), "-o", str(tmp_path / "unknown.mcap"))
    assert code == 0
    assert "diagnosis assumes 30 s" in " ".join(out.split())
    log = tmp_path / "given.mcap"
    code, out, _ = semlive("import", str(folder), "-o", str(log), "--hold-s", "75")
    assert code == 0
    assert "assumes" not in out
    since_step_s = load_observation(OpenedLog(log)).geometry.steps.since_step_s
    assert since_step_s[::2] == pytest.approx(75.0)
    code, _, err = semlive("import", str(folder), "-o", str(log), "--hold-s", "-1")
    assert code == 2
    assert "--hold-s -1: must be from 0" in err
