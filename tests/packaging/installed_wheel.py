"""First steps with the built wheel: import, notebook, live page and exports, from a folder without the source tree.

    python tests/packaging/installed_wheel.py                    # builds the wheel and installs it into an empty environment
    python tests/packaging/installed_wheel.py --wheel WHEEL      # the same with this wheel
    python tests/packaging/installed_wheel.py --python PYTHON    # in an environment that has the wheel already

The interpreter that runs this command needs numpy and scipy; it makes a small folder of maps as input. Exit code 1: a step failed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
import venv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
NOTEBOOK = TESTS.parent / "docs" / "examples" / "analyse_a_log.ipynb"
EXPORTS = {"hdf5": "run.h5", "nexus": "run.nxs", "csv": "csv"}
_READ_H5 = "import h5py, sys; print([len(h5py.File(name)) > 0 for name in sys.argv[1:]])"


def clean_environment() -> dict[str, str]:
    """The environment without paths into a source tree."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")} | {"MPLBACKEND": "Agg"}


def run(command: Sequence[str | Path], folder: Path) -> str:
    """Output of a command that must succeed.

    Raises:
        RuntimeError: its exit code is not 0.
    """
    done = subprocess.run(
        [str(part) for part in command], cwd=folder, env=clean_environment(), capture_output=True, text=True, timeout=1800
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def installed(wheel: Path | None, folder: Path) -> Path:
    """Interpreter of an empty environment into which the wheel, built if none is given, was installed with the extra `pandas`."""
    if wheel is None:
        run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", folder / "wheel", TESTS.parent], folder)
        (wheel,) = (folder / "wheel").glob("*.whl")
    venv.create(folder / "empty", with_pip=True)
    python = folder / "empty" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    # Without byte code: compiling all 6,400 modules takes 34 s of processor time, and the steps import some of them only.
    run([python, "-m", "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check", f"{wheel}[pandas]"], folder)
    return python


def maps_folder(folder: Path) -> Path:
    """A small folder of maps with calibration and load steps, for `semlive import`."""
    code = (
        "from numexp.asfolder import write_folder; from numexp.cases import CASES; from numexp.experiment import make_experiment; "
        "from semlive.data.grid import Grid; import sys; from pathlib import Path; "
        "write_folder(make_experiment(CASES['tension'], 5, Grid(101, 101, 50, 15, 12, 0), calibration_pairs=4), Path(sys.argv[1]))"
    )
    paths = os.pathsep.join((str(TESTS / "benchmarks"), *sys.path))
    subprocess.run([sys.executable, "-c", code, str(folder / "maps")], env={**os.environ, "PYTHONPATH": paths}, check=True)
    return folder / "maps"


@contextmanager
def page(python: Path, log: Path, folder: Path) -> Iterator[str]:
    """Address of the live page of a log, while the server runs."""
    command = [str(python), "-m", "semlive.web", str(log), "--host", "127.0.0.1", "--port", "0", "--exit-with-stdin"]
    process = subprocess.Popen(command, cwd=folder, env=clean_environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    try:
        yield f"http://127.0.0.1:{int(process.stdout.readline())}/"
    finally:
        process.communicate()


def fetched(address: str) -> bytes:
    """Content of an address."""
    with urllib.request.urlopen(address, timeout=60) as reply:
        return reply.read()


def check_page(python: Path, log: Path, folder: Path) -> str:
    """Load the page, all its files, its first state and a map."""
    with page(python, log, folder) as address:
        waiting = re.findall(r'(?:src|href)="(static/[^"]+)"', fetched(address).decode())
        sizes: dict[str, int] = {}
        while waiting:
            name = waiting.pop()
            content = fetched(address + name)
            sizes[name] = len(content)
            imported = re.findall(r'^import .*? from "\./([^"]+)";$', content.decode(), re.MULTILINE) if name.endswith(".js") else []
            waiting += [f"static/{module}" for module in imported if f"static/{module}" not in sizes]
        with urllib.request.urlopen(f"{address}events", timeout=60) as events:
            state = next(json.loads(line[6:]) for line in events if line.startswith(b"data: ") and b'"maps"' in line)
        deadline = time.monotonic() + 60
        while not (frames := state["maps"]["frames"]) and time.monotonic() < deadline:
            with urllib.request.urlopen(f"{address}events", timeout=60) as events:
                state = next(json.loads(line[6:]) for line in events if line.startswith(b"data: ") and b'"maps"' in line)
        field = fetched(f"{address}field/{frames[-1]['frame']}/{frames[-1]['fields'][0]}")
    if not sizes or not all(sizes.values()) or not field:
        raise RuntimeError("the page has an empty file or map")
    return f"{len(sizes)} files, {len(frames)} frames with maps"


def steps(python: Path, notebook: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """Do the steps one after the other; yields the name and the result of each."""
    where = run([python, "-c", "import semlive; print(semlive.__file__)"], folder).strip()
    if not where.startswith(str(Path(python).parent.parent)):
        raise RuntimeError(f"semlive is imported from {where}, which is not the environment")
    yield "installed", run([python, "-m", "semlive", "--version"], folder).strip()
    log = folder / "log.mcap"
    run([python, "-m", "semlive", "import", maps_folder(folder), "-o", log, "--specimen-area-mm2", "1"], folder)
    yield "import", f"{log.stat().st_size} bytes"
    cells = [cell for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    code = "\n".join("".join(cell["source"]) for cell in cells)
    run([python, "-c", f"import os; os.environ['SEMLIVE_LOG'] = {str(log)!r}\n{code}"], folder)
    yield "notebook", f"{len(cells)} cells, {(folder / 'stress_strain.pdf').stat().st_size} bytes of PDF"
    yield "page", check_page(python, log, folder)
    for kind, name in EXPORTS.items():
        run([python, "-m", "semlive", "export", log, "--format", kind, "-o", name], folder)
    opened = run([python, "-c", _READ_H5, "run.h5", "run.nxs"], folder).strip()
    yield "export", f"{', '.join(EXPORTS)}; opened by h5py: {opened}"


def main() -> int:
    """Print each step with its wall time, and the processor time of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheel", type=Path, help="wheel to install; by default it is built")
    parser.add_argument("--python", type=Path, help="interpreter of an environment that has the wheel")
    parser.add_argument("--notebook", type=Path, default=NOTEBOOK)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        began = time.monotonic()
        try:
            python = given.python or installed(given.wheel, folder)
            for name, result in steps(python.absolute(), given.notebook, folder):
                sys.stdout.write(f"{name:10s} {time.monotonic() - began:6.1f} s  {result}\n")
                began = time.monotonic()
        except (RuntimeError, OSError, subprocess.SubprocessError) as error:
            sys.stderr.write(f"{error}\n")
            return 1
    used = os.times()
    sys.stdout.write(f"processor time {used.children_user + used.children_system:.1f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
