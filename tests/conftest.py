"""What holds for every test."""

from __future__ import annotations

import gc
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from itertools import groupby, zip_longest
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from semlive.cli.app import run_app
from semlive.cli.shared import progress_bar
from semlive.service.runtime.blas import limit_blas_threads
from semlive.service.runtime.garbage import enable_garbage_collection
from semlive_drivers.endpoint_lock import _LOCKS

from .waiting import wait_until

# How long an example takes of wall time shows how busy the computer is; where it matters a test counts its own processor time.
settings.register_profile("semlive", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("semlive")


@pytest.fixture(scope="module", autouse=True)
def lower_priority_of_computing(request: pytest.FixtureRequest) -> Iterator[None]:
    """With several processes, tests that only compute run at the priority of the daemon's analysis, not above it.

    At normal priority they left it a tenth of a processor: it needed 91 s of wall time, an hour of simulated time, for the first pair.
    Only root can raise a priority again.
    """
    lower = hasattr(request.config, "workerinput") and _name(request.path).startswith(COMPUTING)
    if not lower or not hasattr(os, "setpriority") or os.geteuid() != 0:
        yield
        return
    before = os.getpriority(os.PRIO_PROCESS, 0)
    os.setpriority(os.PRIO_PROCESS, 0, 10)
    yield
    os.setpriority(os.PRIO_PROCESS, 0, before)


@pytest.fixture(scope="session")
def real_samples() -> Path:
    """The folder of measured images, fields and clocks of others, which are not part of the code base."""
    folder = os.environ.get("SEMLIVE_REAL")
    if not folder:
        pytest.skip("SEMLIVE_REAL does not name the folder of measured data")
    return Path(folder)


@pytest.fixture(scope="session", autouse=True)
def sums_in_one_order() -> None:
    """As in every analysis; choices that lie close together may fall otherwise with sums in another order."""
    limit_blas_threads()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a simulated instrument starts with 0.2 s less processor time


@pytest.fixture(autouse=True)
def no_endpoint_stays_reserved() -> Iterator[None]:
    """A link that a test left open reserves its line to the end of the process, and the next test of another process gets the same name."""
    before = set(_LOCKS)
    yield
    for name in set(_LOCKS) - before:
        _LOCKS.pop(name).lock.release()


@pytest.fixture
def semlive(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """The command line in this process, which saves two seconds of imports: exit code, standard output, standard error.

    A busy computer may need more than the ten seconds after which a command shows its progress on standard error; here none is shown.
    """
    monkeypatch.setattr(progress_bar, "_LINE_INTERVAL_S", math.inf)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["semlive", *map(str, arguments)])
        capsys.readouterr()
        code = run_app()
        return code, *capsys.readouterr()

    return call


@pytest.fixture(scope="session", name="wait_until")
def _wait_until() -> Callable[..., float]:
    return wait_until


COMPILE = (
    # Numba creates many long-lived objects: garbage collection took a tenth of the time of a compilation.
    (
        "-c",
        "import gc; gc.disable(); from semlive import dic; from semlive.data.settings import DicSettings; dic.warm_up(DicSettings())",
    ),
    ("-m", "semlive_simulators.simulate", "--scenario", "short", "--frames", "0", "--out", "."),
)
"""What needs the kernels of most tests: those of correlation and those of the simulators."""


def pytest_sessionstart(session: pytest.Session) -> None:
    """With several processes, compile before they start; all of them, and the daemons of their tests, would compile the same.

    Besides kernels these are the modules of all packages and tests, which are compiled when the tests are collected a first time. The tests
    begin when the file SEMLIVE_TESTS_WAIT_FOR exists, if it is set: programs of others are installed meanwhile.
    """
    count = getattr(session.config.option, "numprocesses", None)
    if not count or hasattr(session.config, "workerinput"):
        return
    collect = [sys.executable, "-m", "pytest", "--collect-only", "-qq", "-p", "no:cacheprovider", *session.config.args]
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as output:
        kernels = [subprocess.Popen([sys.executable, *arguments], cwd=folder, stdout=output, stderr=output) for arguments in COMPILE]
        if count > 1:
            subprocess.run(collect, cwd=session.config.invocation_params.dir, stdout=output, stderr=output, check=False)
        assert [process.wait() for process in kernels] == [0] * len(COMPILE), "the kernels cannot be compiled"
    if peers_installed := os.environ.get("SEMLIVE_TESTS_WAIT_FOR"):
        wait_until(Path(peers_installed).exists, 600.0)


COMPUTING = (
    *("conventions/", "contract/logs/", "contract/test_cli_dic", "contract/test_cli_simulate", "contract/test_simulate"),
    *("golden/", "packaging/", "scenario/diagnose/", "scenario/estimation/"),
    *(f"scenario/test_{name}" for name in ("long_replay", "numerical", "pipeline", "score")),
    *(f"unit/{name}/" for name in ("benchmarks", "diagnose", "dic", "estimate", "formats", "importing", "kernels", "mechanics")),
    *(f"unit/{name}/" for name in ("pipeline", "qualify", "report")),
)
"""Tests that wait for nothing in real time."""
WAITING = (
    *("scenario/test_daemon", "scenario/test_demo", "scenario/test_bench", "fault/", "browser/", "contract/links/"),
    *("contract/test_bench", "contract/test_control"),
)
"""Tests that mostly wait for simulated machines in real time; the others compute."""
LONG_WAITING = (
    *("scenario/test_daemon_qualify", "scenario/test_daemon_stops", "fault/test_daemon_faults", "scenario/test_daemon_model"),
    *("contract/links/test_driver_contract", "fault/test_load_frame_campaign", "scenario/test_demo_short", "browser/test_page_watch"),
    *("scenario/test_daemon_resume", "scenario/test_daemon_warns", "scenario/test_daemon_out_of_memory", "fault/test_every_map"),
    *("scenario/test_daemon_operator_stage", "fault/test_refused_start", "scenario/test_daemon_warm_up", "scenario/test_daemon_beam_shift"),
    *("scenario/test_daemon_triggered", "browser/test_page_bench", "scenario/test_daemon_run"),
)
"""Waiting files of half a minute or more, in the order in which they begin: where one of them began last, a process worked alone for
minutes. The longest one begins after wheel and documentation are built, which would make its simulated instrument late."""
LONG_COMPUTING = (
    *("unit/diagnose/test_decide", "scenario/diagnose/test_diagnose_unknown", "unit/diagnose/test_taken_out", "unit/benchmarks/test_smoke"),
    *("unit/diagnose/test_resolution", "scenario/diagnose/test_diagnose_anew", "unit/diagnose/test_noise_of_other_engines"),
    *("scenario/test_numerical_experiment", "contract/logs/test_cli_reanalyse", "scenario/diagnose/test_diagnose_grey_of_log"),
    *("unit/service/test_live_memory", "unit/dic/test_dic_kernels", "unit/benchmarks/test_rendered_rasters", "unit/dic/test_robust_dic"),
    *("scenario/diagnose/test_diagnose_compare", "contract/logs/test_cli_foretold", "unit/diagnose/test_foretold"),
    *("scenario/diagnose/test_diagnose_names", "unit/diagnose/test_refine"),
)
"""Computing files that begin in turn with these. While waiting files ran one after the other, a tenth of the processors was idle."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Each process imports all tests: 8.1 s of processor time where garbage is collected meanwhile, 5.5 s without."""
    gc.disable()
    try:
        return (yield)
    finally:
        enable_garbage_collection()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With several processes, begin with the long files, then distribute those that wait evenly, so that waiting and computing overlap."""
    if not hasattr(config, "workerinput"):
        return
    files = {_name(tests[0].path): tests for tests in _by_file(items)}
    long = [name for names in zip_longest(LONG_COMPUTING, LONG_WAITING) for name in names]
    ranked = [(float(number - len(long)), files.pop(name)) for number, name in enumerate(long) if name in files]
    for waits in (True, False):
        kind = [tests for name, tests in files.items() if name.startswith(WAITING) is waits]
        ranked += [((number + 0.5) / len(kind), tests) for number, tests in enumerate(kind)]
    items[:] = [test for _, tests in sorted(ranked, key=lambda entry: entry[0]) for test in tests]


def _by_file(items: list[pytest.Item]) -> list[list[pytest.Item]]:
    return [list(tests) for _, tests in groupby(items, key=lambda item: item.path)]


def _name(path: Path) -> str:
    return path.relative_to(Path(__file__).parent).with_suffix("").as_posix()
