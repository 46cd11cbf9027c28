"""`semlive dic` as other programs rely on it."""

import csv
import json
from functools import cache

import cv2
import numpy as np
import pytest
import tifffile
import typer
from typer.testing import CliRunner

from semlive.cli.without_run.dic import dic
from semlive.dic.bands import correlation as banded
from semlive.errors import BadInput


@cache
def speckle(u=0.0, v=0.0):
    """8 bit image of Gaussian spots, 120 x 100 px, moved by (u, v); it is drawn once and cannot be written to."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[0:100, 0:120].astype(float)
    image = np.zeros((100, 120))
    for x0, y0, sign in zip(rng.uniform(-10, 130, 700), rng.uniform(-10, 110, 700), rng.choice([-1.0, 1.0], 700), strict=True):
        image += sign * np.outer(np.exp(-0.125 * (y[:, 0] - y0 - v) ** 2), np.exp(-0.125 * (x[0] - x0 - u) ** 2))
    grey = np.clip(np.round(128 + 39 * image / image.std()), 0, 255).astype(np.uint8)
    grey.flags.writeable = False
    return grey


@pytest.fixture
def folder(tmp_path):
    tifffile.imwrite(tmp_path / "ref.tif", speckle())
    tifffile.imwrite(tmp_path / "a.tif", speckle(1.25, -0.5))
    tifffile.imwrite(tmp_path / "b.tif", speckle(-3.0, 2.5))
    tifffile.imwrite(tmp_path / "small.tif", speckle()[:80])
    (tmp_path / "text.tif").write_text("not an image")
    return tmp_path


def run(*arguments):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command("dic")(dic)
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_json_and_csv(folder):
    out = folder / "deep" / "a.csv"
    result = run(folder / "ref.tif", folder / "a.tif", "--subset", 31, "--roi", "30,25,89,74", "--out", out, "--json")
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    wall_s = figures.pop("wall_s")
    assert 0.0 < wall_s < 5.0
    assert figures == {"points": 120, "converged": 120, "subset_px": 31, "step_px": 5, "method": "subset"}
    assert out.read_text().splitlines()[0] == "x,y,u,v,sigma_u,sigma_v,zncc,status"
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [(row["x"], row["y"]) for row in (rows[0], rows[1], rows[-1])] == [("30", "25"), ("35", "25"), ("85", "70")]
    assert {row["status"] for row in rows} == {"converged"}
    assert np.mean([float(row["u"]) for row in rows]) == pytest.approx(1.25, abs=2e-3)
    assert np.mean([float(row["v"]) for row in rows]) == pytest.approx(-0.5, abs=2e-3)
    assert all(0.0 < float(row["sigma_u"]) < 0.01 and 0.99 < float(row["zncc"]) <= 1.0 for row in rows)


def test_several_images_give_a_list_and_a_folder(folder):
    result = run(folder / "ref.tif", folder / "a.tif", folder / "b.tif", "--subset", 21, "--step", 20, "--out", folder / "maps", "--json")
    figures = json.loads(result.stdout)
    assert [f["points"] for f in figures] == [20, 20]
    assert sorted(path.name for path in (folder / "maps").iterdir()) == ["a.csv", "b.csv"]
    rows = list(csv.DictReader((folder / "maps" / "b.csv").read_text().splitlines()))
    found = [float(row["u"]) for row in rows if row["status"] == "converged"]
    assert len(found) == figures[1]["converged"]
    assert np.median(found) == pytest.approx(-3.0, abs=0.01)
    lost = [row for row in rows if row["status"] != "converged"]
    assert {row["status"] for row in lost} == {"outside_image"}
    assert all(float(row[name]) == 0.0 for row in lost for name in ("u", "v", "sigma_u", "sigma_v", "zncc"))


def test_without_json_a_person_reads_a_line(folder):
    result = run(folder / "ref.tif", folder / "a.tif", "--subset", 31, "--roi", "30,25,89,74")
    assert result.exit_code == 0
    assert "120 of 120 points" in result.stdout
    assert "(+1.25" in result.stdout


def test_progress_is_on_standard_error_alone(folder):
    result = run(folder / "ref.tif", folder / "a.tif", folder / "b.tif", "--step", 20, "--json")
    assert len(json.loads(result.stdout)) == 2
    assert result.stderr.splitlines() == ["correlating 1 of 2: a.tif", "correlating 2 of 2: b.tif"]


def test_a_poor_pattern_is_reported_with_its_figure(folder):
    faint = np.round(128 + (speckle().astype(float) - 128) / 12).astype(np.uint8)
    tifffile.imwrite(folder / "faint.tif", faint)
    result = run(folder / "faint.tif", folder / "faint.tif", "--subset", 31, "--json")
    assert result.exit_code == 0
    assert set(json.loads(result.stdout)) == {"points", "converged", "wall_s", "subset_px", "step_px", "method"}  # a contract
    warnings = [line for line in result.stderr.splitlines() if line.startswith(str(folder / "faint.tif"))]
    assert any(
        "the contrast of the pattern is 3.2 grey levels" in line and "increase the contrast of the detector" in line for line in warnings
    )
    masked = np.zeros(faint.shape, np.uint8)
    cv2.imwrite(str(folder / "nothing.png"), masked)
    result = run(folder / "faint.tif", folder / "faint.tif", "--subset", 31, "--mask", folder / "nothing.png", "--json")
    assert result.exit_code == 1
    figures = json.loads(result.stdout)
    assert figures["converged"] == 0
    assert figures["reason"]["cause"] == "masked"
    assert result.stderr.splitlines() == [
        "correlating 1 of 1: faint.tif",
        f"{folder / 'faint.tif'}: no point was found: the mask excludes every point: use a smaller mask (0 where pixels must not be used)",
    ]


def test_no_point_is_a_failure_with_its_cause(folder):
    tifffile.imwrite(folder / "mirrored.tif", np.ascontiguousarray(speckle()[:, ::-1]))
    result = run(folder / "ref.tif", folder / "a.tif", folder / "mirrored.tif", "--subset", 31, "--out", folder / "maps", "--json")
    assert result.exit_code == 1
    found, lost = json.loads(result.stdout)
    assert found["converged"] > 0
    assert "reason" not in found
    assert lost["converged"] == 0
    assert lost["reason"]["cause"] == "mirrored"
    assert lost["reason"]["remedy"] == "export both frames with the same orientation and scan rotation"
    assert (folder / "maps" / "mirrored.csv").exists()
    *_, reason, last = result.stderr.splitlines()
    assert reason.startswith(
        f"{folder / 'mirrored.tif'}: no point was found: the current frame is mirrored against the reference (left and"
    )
    assert last == "1 of 2 images have no point: mirrored.tif"


def write_as(path, image):
    """The grey image in the format of its name, as colour where that is common."""
    if path.name == "colour.png":
        image = np.stack([image, image // 2 + 40, 255 - image // 3], axis=2)
    elif path.name == "sixteen.png":
        image = image.astype(np.uint16) * 257
    elif path.name == "colour.tif":
        tifffile.imwrite(path, np.stack([image, image, image // 2], axis=2), photometric="rgb")
        return
    cv2.imwrite(str(path), image)


@pytest.mark.parametrize("name", ["a.bmp", "a.jpg", "a.pgm", "colour.png", "sixteen.png", "colour.tif"])
def test_any_image_is_read(folder, name):
    suffix = name.rpartition(".")[0]
    first, second = folder / f"1_{name}", folder / f"2_{name}"
    for path, image in ((first, speckle()), (second, speckle(1.25, -0.5))):
        write_as(path.with_name(name), image)
        path.with_name(name).rename(path)
    out = folder / f"{suffix}.csv"
    result = run(first, second, "--subset", 31, "--roi", "30,25,89,74", "--out", out, "--json")
    assert result.exit_code == 0, result.output
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert {row["status"] for row in rows} == {"converged"}
    assert np.mean([float(row["u"]) for row in rows]) == pytest.approx(1.25, abs=0.01)


def test_uniform_rows_are_no_reason_to_refuse_an_image(folder):
    image = speckle().copy()
    image[92:] = 0
    tifffile.imwrite(folder / "blank.tif", image)
    result = run(folder / "ref.tif", folder / "blank.tif", "--subset", 21, "--roi", "30,25,89,89", "--json")
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert 0.5 < figures["converged"] / figures["points"] < 0.95


def test_a_mask_excludes_points(folder):
    mask = np.full((100, 120), 255, dtype=np.uint8)
    mask[:, :60] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    out = folder / "masked.csv"
    options = ("--subset", 21, "--roi", "20,20,100,80", "--mask", folder / "mask.png", "--out", out, "--json")
    result = run(folder / "ref.tif", folder / "a.tif", *options)
    assert result.exit_code == 0, result.output
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert all(row["status"] != "converged" for row in rows if int(row["x"]) < 48)
    right = [row for row in rows if int(row["x"]) > 72]
    assert all(row["status"] == "converged" for row in right)
    assert np.mean([float(row["u"]) for row in right]) == pytest.approx(1.25, abs=0.01)


@pytest.mark.parametrize("options", [("--interpolation", "quintic"), ("--shape", "quadratic"), ("--shape", "quartic"), ("--search", "4")])
def test_other_splines_shapes_and_searches(folder, options):
    result = run(folder / "ref.tif", folder / "a.tif", "--subset", 31, "--roi", "30,25,89,74", "--json", *options)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["converged"] == 120


def test_processing_a_large_frame_in_bands_does_not_change_the_result(folder, monkeypatch):
    mask = np.full((100, 120), 255, dtype=np.uint8)
    mask[30:50, 40:60] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    tables = []
    for limit in (banded.BAND_POINTS, 50):
        monkeypatch.setattr(banded, "BAND_POINTS", limit)
        out = folder / f"{limit}.csv"
        result = run(folder / "ref.tif", folder / "a.tif", "--subset", 21, "--mask", folder / "mask.png", "--out", out, "--json")
        assert result.exit_code == 0, result.output
        tables.append(out.read_text())
    assert tables[0] == tables[1]


def test_a_wrong_file_is_reported_before_anything_is_written(folder):
    result = run(folder / "ref.tif", folder / "a.tif", folder / "small.tif", "--out", folder / "maps")
    assert isinstance(result.exception, BadInput)
    assert (result.stdout, result.stderr) == ("", "")
    assert not (folder / "maps").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ref.tif", "none.tif"], "none.tif: cannot be read"),
        (["ref.tif", "text.tif"], "text.tif: is neither TIFF nor PNG"),
        (["ref.tif", "small.tif"], "small.tif: is 120 x 80 px but .*ref.tif is 120 x 100 px; export"),
        (["ref.tif", "a.tif", "--subset", "20"], "subset_px must be odd"),
        (["ref.tif", "a.tif", "--step", "0"], "step_px must be at least 1"),
        (["ref.tif", "a.tif", "--mask", "small.tif"], "small.tif: is 120 x 80 px but"),
        (["ref.tif", "a.tif", "--shape", "cubic"], "--shape cubic: no such choice; give affine, quadratic or quartic"),
        (["ref.tif", "a.tif", "--search", "0"], "--search 0: must be more than 0"),
        (["ref.tif", "a.tif", "--roi", "1,2,3"], "--roi 1,2,3: is not four whole numbers"),
        (["ref.tif", "a.tif", "--subset", "101"], "no subset of 101 px fits into the complete frame"),
        (["ref.tif", "a.tif", "--out", "."], "is a folder"),
        (["ref.tif", "a.tif", "b.tif", "--out", "text.tif"], "text.tif is a file"),
    ],
)
def test_bad_input_gives_one_error_line(folder, monkeypatch, arguments, message):
    monkeypatch.chdir(folder)
    result = run(*arguments)
    assert result.stdout == ""
    assert isinstance(result.exception, BadInput)  # the front door turns it into one line and exit code 2
    with pytest.raises(BadInput, match=message):
        raise result.exception
    assert "\n" not in str(result.exception)
