"""Every benchmark still runs on today's code: its smallest run, or what would refuse its run of hours, and in any case its imports.

A new benchmark needs an entry. In this process, because each start of Python with numpy and numba would take two seconds.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import runpy
import sys
import types
from pathlib import Path

import pytest
import yaml

PACKAGES = ("semlive", "semlive_simulators", "semlive_drivers")
BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
RUNS: dict[str, tuple[str, ...]] = {
    "bench_backlog": ("--pairs", "60", "--frames", "2"),
    "bench_bootstrap": ("--score", "--folder", "FOLDER"),
    "bench_challenge": ("--draws", "1", "--patterns", "1", "--variants", "affine, cubic", "--subsets", "21"),
    "bench_coverage": ("--experiments", "1", "--cases", "white", "--keep", "FOLDER"),
    "bench_decide": ("--score", "--folder", "FOLDER"),
    "bench_diagnose_rendered": ("--score", "--folder", "FOLDER"),
    "bench_dic": ("smoke",),
    "bench_dic_accuracy": ("1", "cubic", "--subset", "31"),
    "bench_dic_hard": ("--points", "1000"),
    "bench_dic_tiles": ("1024", "64"),
    "bench_estimate_scale": ("--pairs", "4", "--step", "80"),
    "bench_every_map": ("--list",),
    "bench_frame_check": ("--maps", "1", "--only", "bench"),
    "bench_injected": ("--score", "--folder", "FOLDER"),
    "bench_latency": ("--smoke",),
    "bench_map_waves": ("--runs", "0", "--nulls", "1"),
    "bench_noise": ("short",),
    "bench_noise_shapes": ("--score", "--folder", "FOLDER"),
    "bench_nuisance": ("--score", "--folder", "FOLDER"),
    "bench_peer_frame": ("--list",),
    "bench_qualify": ("--maps", "1", "--tensile", "1"),
    "bench_removed": ("--most", "0"),
    "bench_record": ("--images", "2", "--mb", "0.1", "--rounds", "1"),
    "bench_rendered_rasters": ("--count", "1"),
    "bench_replay": ("--pairs", "3", "--step", "40"),
    "bench_rows": ("smoke",),
    "bench_rtu": ("--readings", "50"),
    "bench_settling_laws": ("--score", "--folder", "FOLDER"),
    "bench_startup": ("--smoke",),
    "bench_stop": ("--runs", "1", "--workers", "1"),
    "bench_turned": ("--score", "--folder", "FOLDER"),
    "bench_verdict_cost": ("--score", "--folder", "FOLDER"),
    "bench_watch": ("--smoke",),
}
"""Arguments of the smallest run."""
SCENARIOS = {"bench_kills": 20.0, "bench_rtu_run": 20.0, "bench_soak": 300.0, "bench_systemd": 20.0}
"""Benchmarks that run the daemon for minutes to hours, and their rates: the daemon accepts their plan."""
IMPORTED = {
    "bench_challenge_star": "installs programs of others",
    "bench_detectable": "a diagnosis of 20 s",
    "bench_diagnose": "a diagnosis of 20 s",
    "bench_estimate": "a pool of processes, 20 s for the smallest case",
    "bench_faults": "runs the daemon for each fault",
    "bench_foretold": "a diagnosis of a minute",
    "bench_grey_channel": "renders at full size only",
    "bench_light": "a series of verdicts, 12 s",
    "bench_page": "needs a browser",
    "bench_peers": "installs programs of others",
    "bench_real_rasters": "needs images that are not in the repository",
    "bench_recommendation": "correlates eight patterns by both methods, 30 s",
    "bench_recover": "needs the log of a run",
    "bench_render": "6 s of rendering",
    "bench_row_start": "needs tables that are not in the repository",
    "bench_row_channel": "a diagnosis of 17 s",
    "bench_sandbox": "needs systemd",
    "bench_scan_channels": "needs images that are not in the repository",
    "bench_second_proof": "three runs of the simulator",
    "bench_share": "needs Samba",
    "bench_start_times": "two experiments of a minute",
    "bench_swallowed": "a diagnosis of a minute",
}
"""Benchmarks that are imported only, and why; what they call is compared with what there is."""


@pytest.fixture(autouse=True)
def _as_a_script(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))


def test_every_benchmark_has_an_entry() -> None:
    present = {path.stem for path in BENCHMARKS.glob("bench_*.py")}
    assert present == RUNS.keys() | SCENARIOS.keys() | IMPORTED.keys()


@pytest.mark.filterwarnings("ignore")  # a scatter of one draw is not a number
@pytest.mark.parametrize("name", RUNS)
def test_the_smallest_run_comes_to_its_end(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So small a run may miss a bar, which is the code 1; it must not break."""
    monkeypatch.setattr(sys, "argv", [name, *(str(tmp_path) if word == "FOLDER" else word for word in RUNS[name])])
    limits = limits_of_threads()
    try:
        runpy.run_path(str(BENCHMARKS / f"{name}.py"), run_name="__main__")
        code: object = 0
    except SystemExit as end:
        code = end.code
    assert code in (None, 0, 1)
    assert limits_of_threads() == limits  # they would be those of all later tests of this process


def limits_of_threads() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name.endswith("_NUM_THREADS")}


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_daemon_accepts_the_plan(name: str) -> None:
    check_plan = importlib.import_module("daemon_plans").check_plan
    bench = importlib.import_module(name)
    given = bench.scenario(1000, 60.0) if name == "bench_soak" else bench.SCENARIO
    check_plan(given if isinstance(given, str) else yaml.safe_dump(given), SCENARIOS[name])


@pytest.mark.parametrize("name", IMPORTED)
def test_the_others_call_what_there_is(name: str) -> None:
    assert broken_uses(importlib.import_module(name)) == []


def test_a_call_of_something_else_is_found() -> None:
    module = types.ModuleType("bench")
    source = "frames.read_frame(1)\nframes.read_image(2)\nHandClock(1, 2, 3)\nHandClock(ns=1)\nVendor.FEI\nVendor.FIE\n"
    scope = {"frames": importlib.import_module("semlive.formats"), "HandClock": importlib.import_module("arrivals.scene").HandClock}
    vars(module).update(scope, Vendor=importlib.import_module("semlive_simulators.exporters.settings").Vendor)
    assert broken_uses(module, source) == [
        "1: missing a required argument: 'profile'",
        "2: no read_image",
        "3: too many positional arguments",
        "6: no FIE",
    ]


def broken_uses(module: types.ModuleType, source: str | None = None) -> list[str]:
    """Attributes that modules and classes of ours lack, and calls of theirs that their signatures do not allow."""
    broken: dict[int, str] = {}
    for node in ast.walk(ast.parse(inspect.getsource(module) if source is None else source)):
        if isinstance(node, ast.Attribute) and (owner := _ours(node.value, module)) is not None:
            if not hasattr(owner, node.attr) and node.attr not in getattr(owner, "__annotations__", {}):
                broken[node.lineno] = f"no {node.attr}"
        elif isinstance(node, ast.Call) and callable(called := _ours(node.func, module)):
            given = {word.arg: None for word in node.keywords if word.arg is not None}
            if len(given) == len(node.keywords) and not any(isinstance(one, ast.Starred) for one in node.args):
                try:
                    inspect.signature(called).bind(*node.args, **given)
                except TypeError as error:
                    broken[node.lineno] = str(error)
                except ValueError:
                    continue  # a class of C without a signature
    return [f"{line}: {problem}" for line, problem in sorted(broken.items())]


def _ours(node: ast.expr, module: types.ModuleType) -> object | None:
    """What a name or attribute of a benchmark refers to, if it is a module, class or function of this repository; None for others."""
    if isinstance(node, ast.Attribute):
        owner = _ours(node.value, module)
        found = None if owner is None else getattr(owner, node.attr, None)
    else:
        found = vars(module).get(node.id) if isinstance(node, ast.Name) else None
    if isinstance(found, types.ModuleType):
        return found if found.__name__.startswith(PACKAGES) else None
    is_ours = isinstance(found, (type, types.FunctionType)) and found.__module__.startswith((*PACKAGES, "arrivals", module.__name__))
    return found if is_ours else None
