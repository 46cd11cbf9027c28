"""Run semlive, or its checks, from a fresh clone with nothing but Python and pip.

    python3 go.py demo [options]     the simulated experiment (other semlive commands work in the same way)
    python3 go.py test [options]     every check; the options go to pytest
    python3 go.py lint               the checks without the tests
    python3 go.py docs [FOLDER]      build the documentation site (build/docs by default)

On Windows: py go.py demo

The first call makes a virtual environment in .venv (or in the folder named by SEMLIVE_VENV) and installs the project
into it; nothing outside that folder is changed. Later calls start at once; the environment is updated after a change of
pyproject.toml or of the Python version.
"""

# Standard library only, and no syntax newer than Python 3.7, so that an older Python can print what is missing.

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent
OLDEST = (3, 11)
WINDOWS = os.name == "nt"


class Refused(Exception):
    """Set-up failed; the message states what failed, where, and what to do."""


def main(argv: list[str]) -> int:
    """Set up the environment of the command, then run the command; returns the exit code."""
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(__doc__)
        return 0 if argv else 2
    for name in ("PYTHONPATH", "PYTHONHOME"):  # the packages of the environment only
        os.environ.pop(name, None)
    command, options = argv[0], argv[1:]
    kinds = {"test": "test", "lint": "test", "docs": "docs"}
    try:
        venv = Path(os.environ.get("SEMLIVE_VENV") or ROOT / ".venv").absolute()
        require_python()
        set_up(venv, kinds.get(command, "run"))
    except Refused as refused:
        print("go.py: " + str(refused), file=sys.stderr)
        return 2
    if command == "docs":
        return build_docs(venv, options)
    if command in kinds:
        return check(venv, options if command == "test" else None)
    return become([str(python_of(venv)), "-m", "semlive", command, *options], os.getcwd())


def require_python() -> None:
    """Raise Refused if this Python is too old or cannot make environments."""
    if sys.version_info < OLDEST:
        required = ".".join(map(str, OLDEST))
        raise Refused(f"semlive needs Python {required} or newer, {sys.executable} is {version()}: install one and start go.py with it.")
    missing = [name for name in ("venv", "ensurepip") if importlib.util.find_spec(name) is None]
    if missing:
        raise Refused(f"{sys.executable} lacks Python's {missing[0]} module: install it (Debian, Ubuntu: apt install python3-venv).")


def set_up(venv: Path, kind: str) -> None:
    """Install into `venv` what `kind` ("run", "test" or "docs") needs, unless its stamp shows that this is done.

    An environment keeps the optional dependencies that were installed before: its kind is then "docs+test", for instance.
    """
    stamp = venv / "semlive-setup.json"
    setup = {
        "pyproject": hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest(),
        "python": version(),
        "root": str(ROOT),
        "kind": kind,
    }
    previous = read_stamp(stamp)
    extras = sorted({kind, *previous.get("kind", "run").split("+")} - {"run"})
    setup["kind"] = "+".join(extras) or "run"
    if previous == setup and python_of(venv).exists():
        return
    print_status(f"setting up {shown(venv)} (once, about a minute) ...")
    start_s = time.monotonic()
    reusable = python_of(venv).exists() and all(previous.get(key) == setup[key] for key in ("python", "root"))
    if not reusable:
        make_environment(venv)
    stamp.unlink(missing_ok=True)
    requirement = str(ROOT) + (f"[{','.join(extras)}]" if extras else "")
    log = venv / "semlive-setup.log"
    python = str(python_of(venv))
    pip = [python, "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--editable", requirement]
    # uv, where it is on PATH, takes 5 s instead of 44 s. It does not read the settings of pip, such as another index.
    uv = shutil.which("uv")
    with_uv = uv is not None and run_logged([uv, "pip", "install", "--python", python, "--editable", requirement], log) == 0
    if not with_uv and run_logged(pip, log) != 0:
        raise Refused(f"pip could not install semlive ({last_error(log)}): see {log}, then start go.py again.")
    stamp.write_text(json.dumps(setup, indent=1) + "\n", encoding="utf-8")
    print_status(f"set up in {time.monotonic() - start_s:.0f} s")


def make_environment(venv: Path) -> None:
    """Make a new virtual environment; an old one is replaced, other folders are not."""
    if venv.exists() and not venv.is_dir():
        raise Refused(f"{venv} is a file, not a folder: remove it or name another folder in SEMLIVE_VENV.")
    if venv.is_dir() and any(venv.iterdir()) and not (venv / "pyvenv.cfg").exists():
        raise Refused(f"{venv} contains files but is no virtual environment: name another folder in SEMLIVE_VENV.")
    try:
        venv.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Refused(f"{venv} cannot be made ({error.strerror}): name another folder in SEMLIVE_VENV.") from None
    made = subprocess.run(
        [sys.executable, "-m", "venv", "--clear", str(venv)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    if made.returncode != 0 or not python_of(venv).exists():
        reason = (made.stdout.strip().splitlines() or ["no output"])[-1]
        raise Refused(f"Python's venv module could not make {venv} ({reason}): correct this, or name another folder in SEMLIVE_VENV.")


def check(venv: Path, pytest_options: list[str] | None) -> int:
    """Run every check, quick checks first, and report all failures; without tests if `pytest_options` is None.

    Pyright takes a minute on one processor; it runs at the same time as the tests and is reported after them.
    """
    python, scripts = str(python_of(venv)), python_of(venv).parent
    quick = {
        "ruff check": [python, "-m", "ruff", "check", "--quiet", "."],
        "ruff format": [python, "-m", "ruff", "format", "--check", "."],
        "lint-imports": [str(scripts / ("lint-imports.exe" if WINDOWS else "lint-imports")), "--no-cache", "--no-logo"],
    }
    start_s = time.monotonic()
    with tempfile.TemporaryFile() as types:
        # A tenth less processor time with a larger young generation of the garbage collector.
        typed = subprocess.Popen(
            [python, "-m", "pyright", "--warnings", "--pythonpath", python],
            cwd=ROOT,
            stdout=types,
            stderr=subprocess.STDOUT,
            env={**os.environ, "NODE_OPTIONS": "--max-semi-space-size=128"},
        )
        failed = [name for name, arguments in quick.items() if not passed(name, arguments)]
        code = 0
        if pytest_options is not None:
            code = become([python, "-m", "pytest", *pytest_options], str(ROOT), replace=False)
            failed += ["pytest"] if code != 0 else []
        if typed.wait() != 0:
            failed.append("pyright")
        print_outcome("pyright", typed.returncode, "" if pytest_options is not None else f"{time.monotonic() - start_s:6.1f} s")
        if typed.returncode != 0:
            types.seek(0)
            print(types.read().decode("utf-8", "replace"), flush=True)
    if failed:
        print_status("failed: " + ", ".join(failed))
    return code or (1 if failed else 0)


def passed(name: str, arguments: list[str]) -> bool:
    """Run a check, report its outcome with the time that it took, and print its output if it fails."""
    start_s = time.monotonic()
    result = subprocess.run(arguments, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    print_outcome(name, result.returncode, f"{time.monotonic() - start_s:6.1f} s")
    if result.returncode != 0:
        print(result.stdout, flush=True)
    return result.returncode == 0


def print_outcome(name: str, code: int, took: str) -> None:
    """Print the outcome of a check in a line of a table."""
    print_status(f"{name:<13} {'ok' if code == 0 else 'FAILED':<7}{took}".rstrip())


def build_docs(venv: Path, options: list[str]) -> int:
    """Build the documentation site into a folder; every warning is an error. Returns the exit code."""
    if len(options) > 1 or any(option.startswith("-") for option in options):
        print("go.py: docs accepts at most one folder: python3 go.py docs [FOLDER]", file=sys.stderr)
        return 2
    site = Path(options[0]).absolute() if options else ROOT / "build" / "docs"
    sphinx = [str(python_of(venv)), "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(ROOT / "docs"), str(site)]
    code = become(sphinx, str(ROOT), replace=False)
    if code == 0:
        print_status(f"open {site / 'README.html'}")
    return code


def become(arguments: list[str], folder: str, replace: bool = True) -> int:
    """Run a program in this terminal: in place of this process if the system supports it, otherwise in a child process."""
    sys.stdout.flush()
    sys.stderr.flush()
    if replace and not WINDOWS:
        os.execv(arguments[0], arguments)
    # Ctrl-C reaches the child, too; this process waits until the child has ended.
    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        return subprocess.Popen(arguments, cwd=folder).wait()
    finally:
        signal.signal(signal.SIGINT, before)


def run_logged(arguments: list[str], log: Path) -> int:
    """Run a program with its output in a file; returns its exit code."""
    with log.open("w", encoding="utf-8") as output:
        return subprocess.run(arguments, stdout=output, stderr=subprocess.STDOUT).returncode


def last_error(log: Path) -> str:
    """Last error in the log of pip, in one line."""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    errors = [line for line in lines if line.lower().startswith("error:")]
    return (errors or lines or ["no output"])[-1].strip().rstrip(".")


def read_stamp(stamp: Path) -> dict[str, str]:
    """Stamp of an environment; empty if it was not set up completely."""
    try:
        content = json.loads(stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def python_of(venv: Path) -> Path:
    """Path of the Python of an environment."""
    return venv / "Scripts" / "python.exe" if WINDOWS else venv / "bin" / "python"


def version() -> str:
    """Version of the running Python without the patch number, because environments stay valid after patches."""
    return ".".join(map(str, sys.version_info[:2]))


def shown(path: Path) -> str:
    """A path for messages, relative to the project if possible."""
    return str(path.relative_to(ROOT)) if ROOT in path.parents else str(path)


def print_status(text: str) -> None:
    """Print a message on standard error; standard output belongs to the command."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
