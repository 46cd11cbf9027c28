"""Maps and tables of frames in the spellings of spreadsheets and programs are imported right, or refused by name and line."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import pytest

from semlive.cli.app import run_app
from semlive.errors import BadInput
from semlive.formats.log.maps import decode_map
from semlive.formats.log.messages import DIC_MAP
from semlive.service.log.files import messages
from semlive.service.replay.import_maps import ImportRequest, import_folder

BODY = "".join(f"{x},{y},1.25,-0.5\n" for y in range(60, 821, 20) for x in range(60, 961, 20))
FRAMES = "frame,pair,phase,start_s,dwell_s,row_time_s,width,height,integrations,load_n,shift_x_px,shift_y_px\n" + "".join(
    f"{n},0,calibration,{30 * n},1e-5,0.0112,1024,884,1,,0,0\n" for n in range(2)
)
COMMAS = FRAMES.replace(",", ";").replace("0.0112", "0,0112")


def folder_with(folder: Path, maps: str | bytes, frames: str | bytes = FRAMES) -> Path:
    folder.mkdir()
    for name, text in (("disparity_0_1.csv", maps), ("frames.csv", frames)):
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder


SPELLINGS = {
    "savetxt": ("# x,y,u,v\n" + BODY, FRAMES),
    "sep": ("sep=,\nx,y,u,v\n" + BODY, FRAMES),
    "semicolons": ("x;y;u;v\n" + BODY.replace(",", ";").replace(".", ","), COMMAS),
    "tabs": ("x\ty\tu\tv\r\n" + BODY.replace(",", "\t").replace("\n", "\r\n"), FRAMES.replace(",", "\t")),
    "blanks": ("# x y u v\n" + BODY.replace(",", " "), "sep=;\n" + COMMAS),
    "three decimals": ("x,y,u,v\n" + BODY.replace("1.25,-0.5", "1.250,-1.500").replace("-1.500", "-0.500"), FRAMES),
    "names": ("X [px];Y [px];U (pixel);V (pixel)\n" + BODY.replace(",", ";"), FRAMES.replace("start_s", "Start S")),
    "units below": ("x;y;u;v\npx;px;px;px\n" + BODY.replace(",", ";"), FRAMES),
    "utf-16": (("x,y,u,v\n" + BODY).encode("utf-16"), COMMAS.encode("utf-16")),
}


@pytest.mark.parametrize("name", SPELLINGS)
def test_a_map_is_the_same_in_every_spelling(tmp_path: Path, name: str) -> None:
    log = tmp_path / "import.mcap"
    import_folder(ImportRequest(folder_with(tmp_path / "maps", *SPELLINGS[name]), log))
    (found,) = [decode_map(item.payload) for item in messages(log) if item.topic == DIC_MAP]
    assert found.valid.all()
    assert (found.u_px == 1.25).all()
    assert (found.v_px == -0.5).all()


def test_decimal_commas_between_commas_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_with(tmp_path / "maps", "x,y,u,v\n" + BODY.replace(".", ","))
    monkeypatch.setattr(sys, "argv", ["semlive", "import", str(folder), "-o", str(tmp_path / "import.mcap")])
    assert run_app() == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert "disparity_0_1.csv: line 2: has 6 cells under 4 names: the numbers seem to have decimal commas" in printed
    assert not (tmp_path / "import.mcap").exists()
    with pytest.raises(BadInput, match=r"frames\.csv: line 2: has \d+ cells under 12 names"):
        import_folder(
            ImportRequest(folder_with(tmp_path / "other", "x,y,u,v\n" + BODY, FRAMES.replace("0.0112", "0,0112")), tmp_path / "log")
        )


def test_a_lost_cell_far_below_the_head_is_refused(tmp_path: Path) -> None:
    lines = ("x,y,u,v\n" + BODY).splitlines()
    lines[1000] = lines[1000].removesuffix(",-0.5")
    with pytest.raises(BadInput, match=r"disparity_0_1\.csv: line 1001: has 3 cells under 4 names"):
        import_folder(ImportRequest(folder_with(tmp_path / "maps", "\n".join(lines)), tmp_path / "log"))


@pytest.mark.parametrize("name", ["disparity_0_1.csv", "frames.csv"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_what_is_no_file_is_refused_without_waiting(tmp_path: Path, name: str, kind: str) -> None:
    folder = folder_with(tmp_path / "maps", "x,y,u,v\n" + BODY)
    (folder / name).unlink()
    if kind == "pipe":
        os.mkfifo(folder / name)
    else:
        (folder / name).symlink_to("/dev/zero")
    errors: list[str] = []

    def attempt() -> None:
        try:
            import_folder(ImportRequest(folder, tmp_path / "log"))
        except BadInput as error:
            errors.append(str(error))

    trial = threading.Thread(target=attempt, daemon=True)
    trial.start()
    trial.join(20.0)
    assert not trial.is_alive()
    assert errors == [f"{folder / name}: cannot be read (it is not a regular file); check the path and its permissions."]
