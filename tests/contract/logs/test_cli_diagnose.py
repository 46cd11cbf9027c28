"""`semlive diagnose`: exit codes, one JSON object, the model's file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from blind.observing import QUICK
from numexp.asfolder import MODULUS_MPA, write_folder
from numexp.cases import CASES
from numexp.experiment import make_experiment
from numexp.stated_estimate import state_estimate

from semlive.cli.shared.simulated_run import require_pairs
from semlive.data.grid import Grid
from semlive.errors import BadInput
from semlive_simulators.scenario import load_scenario

Printed = tuple[int, str, str]
DOMAINS = {"space", "row", "row_start", "scan_time", "frame", "load", "fraction", "spatial_lines", "moves"}


def test_a_verdict_is_one_object_and_the_model_a_file(semlive: Callable[..., Printed], tmp_path: Path) -> None:
    experiment = make_experiment(CASES["magnification"], 3, Grid(101, 101, 20, 38, 30, 43), calibration_pairs=6)
    write_folder(experiment, tmp_path / "maps")
    log, model = tmp_path / "log.mcap", tmp_path / "model.json"
    assert semlive("import", str(tmp_path / "maps"), "-o", str(log), "--subset-px", "43")[0] == 0
    state_estimate(log, QUICK)

    code, out, _ = semlive("diagnose", str(log), "--json", "-o", str(model), "--html", str(tmp_path / "page.html"))

    found = json.loads(out)
    assert code == 0
    assert set(found) >= {"outcome", "effects", "ambiguous", "group", "experiment", "gap", "where"}
    assert (found["outcome"], found["group"]) == ("IDENTIFIED", "G1")
    (effect,) = found["effects"]
    assert effect["name"] == "magnification_drift"
    assert set(effect["parameters"]["change"]) == {"value", "sigma", "unit"}
    assert set(found["gap"]) == {"before_px", "after_px", "floor_px", "closure", "closure_interval"}
    assert {item["domain"] for item in found["where"]} <= DOMAINS
    written = json.loads(model.read_text())
    assert [{key: item[key] for key in effect} for item in written["effects"]] == found["effects"]
    assert (written["version"], written["parent_sha256"], len(written["data_sha256"])) == (1, None, 64)

    page = (tmp_path / "page.html").read_text()
    assert all(word in page for word in ("IDENTIFIED", "magnification_drift", "Next experiment", "95 % interval"))
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert "acceleration voltage not recorded" in page or "made from disparity maps of another program" in page
    figures = re.findall(r'<figure id="(.*?)">', page)
    assert figures == ["profile-magnification-drift", "misfit", "residual-maps", "residual-quantiles", "evidence", "overlap"]
    assert page.count("src=") == page.count('src="data:image/svg+xml,') == len(figures)
    assert "holds no images" in page
    assert found["rows"]["looked_at"] is False
    # One shape in space with another clock is nearly the same, another shape is not.
    assert "magnification_drift" not in found["overlap"]
    assert found["overlap"]["magnification_frame_instability"] > 0.9
    assert found["overlap"]["dic_subpixel_bias"] < 0.3
    assert found["evidence"]["magnification_drift"] == max(found["evidence"].values())

    code, out, _ = semlive("diagnose", str(log))
    words = " ".join(out.split())
    assert code == 0
    assert f"p = {effect['p_value']:.3f}, logarithm of the Bayes factor {effect['log_bayes_factor']:.1f}" in words

    code, out, _ = semlive("diagnose", str(log), "--json", "--model", str(model))
    assert (code, json.loads(out)["outcome"]) == (0, "NONE")
    code, out, _ = semlive("replay", str(log), "--json", "--model", str(model))
    assert code == 0
    assert any("magnification_drift" in item for item in json.loads(out)["warnings"])


def gaged(folder: Path, share: float) -> None:
    """A gage that reports a share of the strain under each load, where loads are those of an area of 1 mm^2."""
    head, *lines = (folder / "frames.csv").read_text().splitlines()
    loads = [line.split(",")[head.split(",").index("load_n")] for line in lines]
    printed = [f"{line},{share * float(load) / MODULUS_MPA if load else ''}" for line, load in zip(lines, loads, strict=True)]
    (folder / "frames.csv").write_text("\n".join([f"{head},gage_strain", *printed, ""]))


def test_strain_that_a_gage_does_not_show_is_reported_and_not_corrected(semlive: Callable[..., Printed], tmp_path: Path) -> None:
    folder = write_folder(make_experiment(CASES["tension"], 3, Grid(101, 101, 20, 38, 30, 43), calibration_pairs=6), tmp_path / "maps")
    log, model, page = tmp_path / "log.mcap", tmp_path / "model.json", tmp_path / "page.html"
    assert semlive("import", str(folder), "-o", str(log), "--subset-px", "43")[0] == 0
    state_estimate(log, QUICK)
    without = json.loads(semlive("diagnose", str(log), "--json")[1])
    assert (without["outcome"], without["gap"]) == ("NONE", None)
    assert "gage_readings" not in {item["domain"] for item in without["where"]}
    assert "out_of_plane_translation" not in without["evidence"]
    proof = tmp_path / "proof"
    code, out, _ = semlive("diagnose", str(log), "--prove", "short", "--prove-out", str(proof), "--json")
    residual = json.loads(out)["residual"]
    assert (code, json.loads(out)["proof"], [path.name for path in proof.iterdir()]) == (0, None, ["diagnosis.html"])
    assert (residual["added"], residual["nothing_added"]) == ([], "no effect was identified")
    assert "Nothing was added and nothing was simulated: no effect was identified." in (proof / "diagnosis.html").read_text()
    for item in residual["channels"]:
        before, noise = item["before"], item["expected"]
        assert item["after"] is None
        assert abs(before["value"] - noise["value"]) < 4.0 * math.hypot(before["sigma"], noise["sigma"])

    gaged(folder, 0.9)
    assert semlive("import", str(folder), "-o", str(log), "--subset-px", "43")[0] == 0
    state_estimate(log, QUICK)
    code, out, _ = semlive("diagnose", str(log), "-o", str(model), "--html", str(page))
    printed = " ".join(out.split())
    assert code == 0
    assert "IDENTIFIED" in printed
    assert "strain is not corrected for it; it would change Young's modulus by +11 +-" in printed
    assert "and change Young&#x27;s modulus by +11 ±" in page.read_text()
    (effect,) = json.loads(model.read_text())["effects"]
    assert (effect["name"], effect["looks_like_strain"], effect["strain_eaten"]) == ("out_of_plane_translation", True, 1.0)
    # A tenth of the strain, of which the loads are the modulus times 1 mm^2.
    lift = effect["parameters"]["strain_per_n"]
    assert abs(lift["value"] - 0.1 / MODULUS_MPA) < 3.0 * lift["sigma"]

    code, out, _ = semlive("replay", str(log), "--json", "--model", str(model))
    assert code == 0
    assert "model: out_of_plane_translation is strain to the maps, and is left in" in json.loads(out)["warnings"]


def test_too_few_pairs_give_one_error_line(semlive: Callable[..., Printed], short: Path) -> None:
    code, out, err = semlive("diagnose", str(short), "--json")
    assert (code, out) == (1, "")
    assert "needs at least 5 pairs" in err.splitlines()[-1]


def test_prove_needs_a_new_folder(semlive: Callable[..., Printed], tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "model.json").write_text("{}")
    code, out, err = semlive("diagnose", str(tmp_path / "no-log"), "--prove", "short", "--prove-out", str(tmp_path / "old"))
    assert (code, out) == (2, "")
    assert "the folder is not empty; give a new folder" in " ".join(err.split())


def test_a_scenario_of_another_length_is_refused_before_its_run() -> None:
    bench = {"experiment": load_scenario("short").experiment}
    require_pairs(bench, 9)
    with pytest.raises(BadInput, match="the scenario has 9 pairs and the measured run 15; give a scenario with the protocol of that run"):
        require_pairs(bench, 15)
