"""What Octave makes of semlive's files: ``python tests/benchmarks/read_by_octave.py`` (GNU Octave must be on the path).

1. The lines of docs/how-to/import.md for Ncorr's users, run as they stand on files of Ncorr's layout; the maps that they write are
   imported, replayed, and compared with those that were put in.
2. An exported .mat is loaded there, and one field is compared number by number.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import scipy.io
from numexp.asfolder import HEADER, frame_lines
from numexp.cases import CASES
from numexp.experiment import Experiment, make_experiment

import semlive
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid

DOCS = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "import.md"
STEP_PX, PIXEL_UM = 25, 0.12


def snippet() -> str:
    """The lines for Ncorr's users, as the documentation has them."""
    after = DOCS.read_text(encoding="utf-8").split("Ncorr writes no text", 1)[1].splitlines()[2:]
    return "\n".join(line[4:] for line in after[: next(at for at, line in enumerate(after) if not line.startswith("    "))])


def octave(script: str, folder: Path) -> str:
    """Standard output of a script, run in a folder; an error of Octave's is one here."""
    done = subprocess.run(
        ["octave", "--no-gui", "--norc", "--quiet", "--eval", script], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return done.stdout


def as_ncorr(one: DisparityMap, path: Path) -> None:
    """A map as Ncorr saves it: fields over the complete image at every (spacing + 1)-th pixel from (0, 0), in units of length."""
    grid = one.grid
    ny, nx = (grid.y0_px + grid.step_px * grid.ny) // grid.step_px, (grid.x0_px + grid.step_px * grid.nx) // grid.step_px
    u, v, mask = np.zeros((ny, nx)), np.zeros((ny, nx)), np.zeros((ny, nx), dtype=np.bool_)
    inside = slice(grid.y0_px // grid.step_px, None), slice(grid.x0_px // grid.step_px, None)
    u[inside], v[inside], mask[inside] = one.u_px * PIXEL_UM, one.v_px * PIXEL_UM, one.valid
    shown = {"plot_u_ref_formatted": u, "plot_v_ref_formatted": v, "roi_ref_formatted": {"mask": mask}}
    reported = {"spacing": float(grid.step_px - 1), "pixtounits": PIXEL_UM, "units": "um"}
    scipy.io.savemat(path, {"data_dic_save": {"displacements": shown, "dispinfo": reported}})


def imported(experiment: Experiment, folder: Path) -> Path:
    """A log, by the documentation's lines and `semlive import`; the maps in it are those of the experiment."""
    lines, maps = [HEADER], {}
    for pair in experiment.pairs:
        lines += frame_lines(pair, pair.pair, 0.0, 1.0)
        for one in pair.maps:
            path = folder / f"ncorr_{one.reference}_{one.current}.mat"
            as_ncorr(one, path)
            octave(f"load('{path.name}'); ref = {one.reference}; cur = {one.current};\n{snippet()}", folder)
            maps[one.reference, one.current] = one
    (folder / "frames.csv").write_text("\n".join([*lines, ""]))
    log = folder / "by-ncorr.mcap"
    run("import", str(folder), "-o", str(log), "--specimen-area-mm2", "1.0")
    for (reference, current), one in maps.items():
        x, y, u, v, valid = np.loadtxt(folder / f"disparity_{reference}_{current}.csv", delimiter=",", skiprows=1).T
        observed = valid == 1
        at = ((y[observed] - one.grid.y0_px) / STEP_PX).astype(int), ((x[observed] - one.grid.x0_px) / STEP_PX).astype(int)
        assert observed.sum() == one.valid.sum()
        for reported, field in ((u, one.u_px), (v, one.v_px)):
            np.testing.assert_allclose(reported[observed], field[at], rtol=1e-8, atol=1e-9)
    return log


def run(*arguments: str) -> str:
    """Standard output of `semlive ARGUMENTS`."""
    return subprocess.run([sys.executable, "-m", "semlive", *arguments], capture_output=True, text=True, check=True).stdout


def export_opens(log: Path, folder: Path) -> None:
    """Load the export there and compare a field; what Octave reads of HDF5 has no variable-length texts, so .mat is for it."""
    log_data = semlive.open_log(log)
    last = len(log_data.frames) - 1
    run("export", str(log), "--format", "mat", "-o", str(folder / "out.mat"))
    octave(f"load('out.mat'); e = frame_{last:05d}.eyy; save('-v7', 'back.mat', 'e');", folder)
    np.testing.assert_array_equal(scipy.io.loadmat(folder / "back.mat")["e"], log_data.frames[last].eyy)
    sys.stdout.write(f"frame_{last:05d}.eyy of {log_data.frames[last].eyy.size} points is the same\n")


def main() -> None:
    """Run all, report which were the same."""
    grid = Grid(100, 100, STEP_PX, 30, 24, 0)
    experiment = make_experiment(CASES["tension"], 5, grid, calibration_pairs=4)
    with tempfile.TemporaryDirectory(prefix="semlive-octave-") as name:
        folder = Path(name)
        log = imported(experiment, folder)
        reported = json.loads(run("replay", str(log), "--json"))
        sys.stdout.write(
            f"Ncorr's lines ran on {len(list(folder.glob('ncorr_*.mat')))} files; "
            f"{reported['pairs']} pairs replayed: {reported['elastic']}\n"
        )
        export_opens(log, folder)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main()
