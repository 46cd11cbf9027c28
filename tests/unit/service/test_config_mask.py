"""The mask of a configuration: read and checked when the file is loaded, before anything moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from semlive.data.settings import AnalysisSettings, DicSettings
from semlive.errors import BadConfig, BadInput
from semlive.inputs.mask_file import read_mask
from semlive.service.checks.run_checks import run_checks
from semlive.service.config.configuration import Config, load_config, parse_config
from semlive.service.config.mask import read_mask_file, usable_points
from semlive.service.config.overrides import apply_overrides, as_keys, parse_changes
from semlive.service.planning.planning import plan_experiment
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario


def write_mask(path: Path, excluded: tuple[slice, slice], width: int = 320, height: int = 240) -> Path:
    image = np.full((height, width), 255, dtype=np.uint8)
    image[excluded] = 0
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return path


def write_config(folder: Path, mask: str | None) -> Path:
    path = folder / "run.yaml"
    values = {
        "sem": {"folder": "export", "pixel_size_um": 1.25, "profile": {"frame_time_s": 10.0}},
        "protocol": {"calibration_shifts_px": [[0, 0]]},
        "dic": {"subset_px": 21, "step_px": 10, "roi_px": [20, 20, 300, 220], "mask": mask},
    }
    path.write_text(yaml.safe_dump(values), encoding="utf-8")
    (folder / "export").mkdir(exist_ok=True)
    return path


def loaded(folder: Path) -> Config:
    write_mask(folder / "mask.png", np.s_[60:120, 100:200])
    return load_config(write_config(folder, "mask.png"))


def test_a_configuration_without_mask_is_as_before(tmp_path: Path) -> None:
    assert load_config(write_config(tmp_path, None)).dic.mask is None


def test_the_bytes_of_the_mask_are_in_the_configuration_that_the_log_contains(tmp_path: Path) -> None:
    config = loaded(tmp_path)
    logged = parse_config(config.model_dump(mode="json"), "the log")
    assert logged.dic == config.dic
    assert logged.dic.mask is not None
    assert int((~read_mask(logged.dic.mask)).sum()) == 60 * 100


@pytest.mark.parametrize(
    ("excluded", "name", "reason"),
    [
        (None, "none.png", r"line \d+: dic\.mask: .*none\.png: cannot be read \(No such file or directory\); give a PNG file"),
        (np.s_[:, :], "mask.png", r"dic\.mask: .*mask\.png: the mask excludes every pixel"),
        (np.s_[5:235, 5:315], "mask.png", r"dic\.mask: the mask excludes all 609 points of dic\.roi_px 20,20,300,220"),
    ],
)
def test_a_mask_that_cannot_be_used_is_refused_when_the_file_is_loaded(
    tmp_path: Path, excluded: tuple[slice, slice] | None, name: str, reason: str
) -> None:
    if excluded is not None:
        write_mask(tmp_path / name, excluded)
    with pytest.raises(BadConfig, match=reason):
        load_config(write_config(tmp_path, name))


def test_a_region_outside_a_frame_of_the_size_of_the_mask_is_refused(tmp_path: Path) -> None:
    write_mask(tmp_path / "mask.png", np.s_[0:5, 0:5], width=24, height=24)
    with pytest.raises(BadConfig, match=r"dic\.mask: no subset of 21 px fits into roi 20,20,300,220 of a 24 x 24 px frame"):
        load_config(write_config(tmp_path, "mask.png"))


def test_points_are_excluded_as_the_correlation_excludes_them(tmp_path: Path) -> None:
    from semlive import dic  # noqa: PLC0415  (kernels)
    from semlive.data.disparity import PoiStatus  # noqa: PLC0415

    settings = loaded(tmp_path).dic
    mask = dic.mask_of(settings, (240, 320))
    assert mask is not None
    image = np.random.default_rng(1).integers(0, 255, (240, 320), dtype=np.uint8)
    reference = dic.prepare(image, dic.grid_for(settings, 320, 240), settings, mask)
    assert np.array_equal(usable_points(mask, settings), reference.status != PoiStatus.MASKED)


def test_doctor_reports_the_mask(tmp_path: Path) -> None:
    (mask,) = (finding for finding in run_checks(loaded(tmp_path)) if finding.what == "mask")
    assert "PNG of 320 x 240 px, 7.8 % excluded" in mask.observation
    assert "of 609 points" in mask.observation


def test_plan_refuses_a_test_frame_of_another_size(tmp_path: Path) -> None:
    scan = replace(load_scenario("paper_x200").scan, width_px=64, height_px=48, frame_time_s=0.48)
    image = np.random.default_rng(1).integers(0, 256, (48, 64), dtype=np.uint8)
    exported = Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 0, "x", Vendor.FEI).encode(image, ImageMetadata(scan, 10**18, 0, 0, 0, "a.tif"))
    frame_file = tmp_path / "a.tif"
    frame_file.write_bytes(exported.image)
    with pytest.raises(BadInput, match="the mask is 320 x 240 px but the frame"):
        plan_experiment(loaded(tmp_path), frame_file)


def test_plan_without_test_frame_assumes_the_size_of_the_mask(tmp_path: Path) -> None:
    planned = plan_experiment(loaded(tmp_path))
    assert (planned.scan.width_px, planned.scan.height_px) == (320, 240)


def test_a_mask_is_set_by_its_file_and_removed_by_null(tmp_path: Path) -> None:
    path = write_mask(tmp_path / "mask.png", np.s_[0:50, 0:50])
    settings = apply_overrides(AnalysisSettings(), parse_changes([f"dic.mask={path}"]))
    assert settings.dic == replace(DicSettings(), mask=read_mask_file(path))
    assert as_keys(settings)["dic.mask"].startswith("PNG of 320 x 240 px")
    assert apply_overrides(settings, parse_changes(["dic.mask=null"])) == AnalysisSettings()
