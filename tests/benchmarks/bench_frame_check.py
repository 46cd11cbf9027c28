"""`semlive frame check` on random wrong register maps, against the simulated bench and the independent load frame.

    python tests/benchmarks/bench_frame_check.py [--maps 200] [--seed 1] [--write] [--only bench|peer] [--peers FOLDER]

Each map is a right one with one random error of the kinds in `frame_check_maps.ERRORS`, in two cases of ten with two. Every map is checked
twice at a random load: alone, as a first look, and with what the device's panel shows. A diagnosis is right if the device's own layout
(table, address, format, order of words and bytes, scale) is the one that the check names, or is among those that it lists with a way to
decide. The right maps are checked, too. `--write` writes one section of docs/validation/robustness.md. The exit status is 1 if a bar is
missed: 95 % right, and no wrong map called sound.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "simulators"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "drivers"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import yaml
from frame_check_maps import ERRORS, Case, Truth, peer_frame, peer_truths, simulated_truth, wrong_maps
from peer_frame.building import PEERS, build, missing_tool

from semlive.data.checks import FrameCheck
from semlive_drivers.modbus.check import check_modbus
from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.load_frame.server import BenchRegisters, ModbusThread
from semlive_simulators.microscope.sem import Sem
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.machine import LoadTrain

MIN_RIGHT = 0.95
PAGE = Path(__file__).resolve().parents[2] / "docs" / "validation" / "robustness.md"
BEGIN, END = "<!-- bench_frame_check -->", "<!-- end of bench_frame_check -->"


@dataclass(frozen=True)
class Outcome:
    """What both checks of one wrong map showed."""

    errors: tuple[str, ...]
    alone: bool
    """Named as the only explanation, or among several, without a known reading."""
    unique: bool
    """Named as the only explanation with known readings."""
    named: bool
    """Named, alone or among several, with known readings."""
    sound: bool
    """Called sound in one of the checks."""


def names_truth(result: FrameCheck, case: Case) -> tuple[bool, int]:
    """Whether a check lists the device's own layout, and how many layouts it lists."""
    texts = [finding.advice for finding in result.findings if finding.what.startswith("explanation")]
    return any(case.is_right(text) for text in texts), len(texts)


def judge(case: Case, folder: Path) -> Outcome:
    """Check one wrong map, alone and with known readings."""
    path = folder / "wrong.yaml"
    path.write_text(yaml.safe_dump(case.content), encoding="utf-8")
    settings = {"port": case.truth.port, "timeout_s": 3.0}
    alone = check_modbus(str(path), settings)
    force, extension = case.truth.panel()
    findings = check_modbus(str(path), {**settings, "force_reads": force, "extension_reads": extension})
    first, _ = names_truth(alone, case)
    named, count = names_truth(findings, case)
    return Outcome(case.errors, first, named and count == 1, named, alone.passed or findings.passed)


def right_maps(truths: Sequence[Truth], folder: Path) -> tuple[int, int]:
    """Right maps that are sound with known readings, of those checked."""
    sound = 0
    for truth in truths:
        path = folder / "right.yaml"
        path.write_text(yaml.safe_dump(truth.content), encoding="utf-8")
        force, extension = truth.panel()
        result = check_modbus(str(path), {"port": truth.port, "timeout_s": 3.0, "force_reads": force, "extension_reads": extension})
        sound += result.passed
    return sound, len(truths)


@contextmanager
def simulated_bench(folder: Path, force_n: float) -> Iterator[int]:
    """TCP port of a simulated bench that is loaded and at rest."""
    scenario = load_scenario("paper_x200")
    clock = BenchClock(1.0, lambda _: None)
    machine = LoadTrain(scenario, clock.start_ns)
    machine.read(clock.start_ns)
    sem = Sem(scenario, clock, machine, folder / f"export{force_n:.0f}", True, lambda _: None, lambda _: None)
    server = ModbusThread(BenchRegisters(scenario, clock, machine, sem), 0)
    port = server.start()
    clock.begin()
    machine.ramp_to(force_n, 1e4)
    yield port
    server.stop()


def line_of(outcome: Outcome) -> str:
    """One outcome as a line."""
    verdict = "sound: WRONG" if outcome.sound else "named" if outcome.unique else "named among several" if outcome.named else "NOT NAMED"
    return f"{verdict:22} {'first look' if outcome.alone else '':11} {', '.join(outcome.errors)}\n"


def table(outcomes: Sequence[Outcome]) -> str:
    """The figures by kind of error, in Markdown."""
    rows = ['| error | maps | named at the first look | with known readings: named | named among several | not named | wrong "sound" |']
    rows.append("|---|---|---|---|---|---|---|")
    for kind in (*ERRORS, "two errors", "all"):
        found = [one for one in outcomes if kind == "all" or (one.errors == (kind,)) or (kind == "two errors" and len(one.errors) > 1)]
        counts = Counter("unique" if one.unique else "several" if one.named else "none" for one in found)
        cells = (len(found), sum(one.alone for one in found), counts["unique"], counts["several"], counts["none"])
        rows.append(f"| {kind} | {' | '.join(map(str, cells))} | {sum(one.sound for one in found)} |")
    return "\n".join(rows)


def main() -> int:
    """Check the maps and show the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--maps", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=("bench", "peer"), default=None)
    parser.add_argument("--write", action="store_true", help=f"write the section of {PAGE.name}")
    parser.add_argument("--peers", type=Path, default=PEERS, help="folder of the source of the independent frame")
    options = parser.parse_args()
    if options.only != "bench" and (why := missing_tool(options.peers)):
        parser.error(f"{why}; or give --only bench")
    rng = random.Random(options.seed)
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        truths: list[Truth] = []
        if options.only != "peer":
            truths += [simulated_truth(stack.enter_context(simulated_bench(folder, force_n)), force_n) for force_n in (217.4, 63.1)]
        if options.only != "bench":
            truths += peer_truths(stack.enter_context(peer_frame(build(options.peers, folder), folder, F=-117.3628, E=-0.4711)))
        outcomes = []
        for case in wrong_maps(truths, rng, options.maps):
            outcomes.append(judge(case, folder))
            sys.stdout.write(f"{len(outcomes):4} {case.truth.name:12} {line_of(outcomes[-1])}")
            sys.stdout.flush()
        sound, checked = right_maps(truths, folder)
    named, wrong = sum(one.named for one in outcomes), sum(one.sound for one in outcomes)
    shown = f'{table(outcomes)}\n\nRight diagnosis {named} of {len(outcomes)} ({named / len(outcomes):.1%}); wrong "sound": {wrong}. '
    shown += f"Right maps that are sound with known readings: {sound} of {checked}; "
    shown += "the extension of the simulated bench is too noisy to prove its scale.\n"
    sys.stdout.write(f"\n{shown}")
    if options.write:
        text = PAGE.read_text(encoding="utf-8")
        begin, end = text.index(BEGIN) + len(BEGIN), text.index(END)
        PAGE.write_text(f"{text[:begin]}\n{shown}{text[end:]}", encoding="utf-8")
    return int(named < MIN_RIGHT * len(outcomes) or wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
