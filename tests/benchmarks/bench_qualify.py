"""Qualification: coverage of the stated intervals, and the limiting effect of simulated microscopes.

    python tests/benchmarks/bench_qualify.py [--microscopes N] [--strained N] [--keep FOLDER] [--write]
    python tests/benchmarks/bench_qualify.py [--maps N] [--tensile N] [--protocols N] [--scenarios [NAME ...]] [--write]
    python tests/benchmarks/bench_qualify.py --daemon [NAME ...] [--write]

`--microscopes N` draws N microscopes at random, renders and qualifies their frames, and compares every figure and the named limit with the
truth; `--keep FOLDER` stores each result, so that an interrupted count continues. `--strained N` compares the predicted strain noise of the
first N of them with the error of a rendered tensile run that follows. `--maps N` draws N microscopes (7 calibration pairs of 30
x 24 points with drift, distortion and noise of the simulators' code, no images) and counts the intervals that hold the truth. `--tensile N`
compares the predicted strain noise of N microscopes with the error of a tensile run, `--protocols N` the recommended protocol of N
microscopes with 20 random ones of equal beam time. `--scenarios` renders the frames of scenarios `qualify_*`, all without a name, and
evaluates them by the command's code. Without any of these all are made, 60, 60, 60, 6 and 6 microscopes. `--write` writes the tables into
docs/validation/qualification.md. Exit code 1 if a coverage is below its exact band, a limit is not named, a noise differs by more than
10 %, or a random protocol is better by more than 10 %.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numexp.coverage import CALIBRATION_PAIRS, GRID, SMALL, WINDOW_POINTS, affine_distortion
from numexp.experiment import Experiment, make_experiment
from numexp.world import HEIGHT_PX, WIDTH_PX, Field
from qualify_counts import band, cases, further_rows, limit_rows
from qualify_counts import coverage_rows as microscope_rows
from qualify_daemon import daemon_rows
from qualify_protocols import Tried, contest
from qualify_steps import step_rows
from qualify_strained import MAX_NOISE_ERROR, strained, strained_rows
from qualify_tensile import compared

from semlive import estimate
from semlive.data.settings import EstimateSettings
from semlive.qualify.figures.distortion import HALF_SHIFT_PX, draw_distortion, gauge_strain_per_px, sample_points, stencil, without_affine
from semlive.qualify.figures.drift import pair_rate
from semlive.qualify.figures.intervals import magnitude_interval
from semlive.qualify.figures.noise import displacement_scatter
from semlive.qualify.protocol import GAUGE_PX
from semlive.service.qualification.run import QualifyRequest, qualify_source
from semlive.service.runtime.blas import limit_blas_threads
from semlive_simulators.scenario import load_scenario
from semlive_simulators.simulate import simulate

FIRST_SEED = 20_000
DOCS = Path(__file__).resolve().parents[2] / "docs" / "validation" / "qualification.md"
RANDOM_PROTOCOLS, MAX_PROTOCOL_RATIO = 20, 1.1
"""Protocols that are tried, and largest error of the recommended one over that of the best of them."""
EVERYTHING = (60, 60, 60, 6, 6)
"""Microscopes of each kind if none is requested."""
LIMITING = {
    "qualify_good": "image_noise",
    "qualify_warm_tungsten": "drift",
    "qualify_hum": "mains_hum",
    "qualify_slow_settling": "row_start_settling",
    "qualify_poor_stage": "stage",
    "qualify_wrong_row_time": "wrong_row_time",
}
"""The effect of each simulated microscope; it must be the limit without or with correction."""


@dataclass(frozen=True, slots=True)
class Checked:
    """A stated interval with its truth.

    Attributes:
        name: of the figure.
        true: true value.
        interval: value, lower and upper end.
    """

    name: str
    true: float
    interval: tuple[float, float, float]

    @property
    def inside(self) -> bool:
        """Whether the interval holds the truth."""
        return self.interval[1] <= self.true <= self.interval[2]


def checked(seed: int) -> list[Checked]:
    """Figures of one simulated microscope. Noise is shared over subsets, as that of a correlation is."""
    experiment = make_experiment(SMALL["correlated"], seed, GRID, CALIBRATION_PAIRS)
    state = estimate.init(EstimateSettings(window_points=WINDOW_POINTS), GRID, WIDTH_PX, HEIGHT_PX)
    for taken in experiment.pairs:
        state = estimate.update(state, taken.pair, taken.phase, taken.times, taken.maps)
    solution = estimate.solve(state)
    field = estimate.to_estimate(solution, 0).distortion
    draws = draw_distortion(solution, field, GAUGE_PX)
    outer, inner = sample_points(field, 0.0), sample_points(field, 0.5 * GAUGE_PX + HALF_SHIFT_PX)

    def bend(x: Field, y: Field) -> Field:
        return experiment.world.bend_px(np.column_stack((x, y)))

    largest = float(np.linalg.norm(without_affine(bend(*outer), *outer), axis=1).max())
    strain = np.abs(gauge_strain_per_px(np.stack([bend(*points) for points in stencil(*inner, GAUGE_PX)]), GAUGE_PX)).max()
    return [
        Checked("distortion", largest, draws.largest_px),
        Checked("false_strain_per_px", float(strain), draws.strain_per_px),
        *_drift(experiment),
        _noise(experiment),
    ]


def _drift(experiment: Experiment) -> list[Checked]:
    """Rate of every calibration pair; the truth is the mean motion from frame to frame, in px of the distorted image."""
    x, y = (axis.ravel() for axis in GRID.mesh())
    drift, distorted, found = experiment.world.column.drift, np.eye(2) + affine_distortion(experiment), list[Checked]()
    for taken in experiment.pairs[:CALIBRATION_PAIRS]:
        interval_s = taken.times[1].start_s - taken.times[0].start_s
        before, after = (drift.at(when.start_s + when.timing.time_in_frame_s(x, y)).mean(axis=0) for when in taken.times)
        rate = pair_rate(taken.maps[0], interval_s, 0.0, taken.times[0].timing.row_time_s.value)
        found.append(Checked("drift_rate", float(np.linalg.norm(distorted @ (after - before))) / interval_s, magnitude_interval(*rate, 1)))
    return found


def _noise(experiment: Experiment) -> Checked:
    scatter = displacement_scatter([taken.maps[0] for taken in experiment.pairs[:CALIBRATION_PAIRS]])
    assert scatter is not None  # the grid is large enough
    return Checked("noise", experiment.case.noise_px, scatter.worst())


def coverage(count: int) -> dict[str, list[Checked]]:
    """Checked intervals of many microscopes by figure."""
    found: dict[str, list[Checked]] = {}
    for number in range(count):
        for item in checked(FIRST_SEED + number):
            found.setdefault(item.name, []).append(item)
        sys.stderr.write(f"\r{number + 1}/{count} ")
    sys.stderr.write("\n")
    return found


def limiting(name: str, *, search_effects: bool = True) -> tuple[str, str]:
    """Limiting effect of a scenario without and with correction, by the frames that it renders."""
    with tempfile.TemporaryDirectory(prefix="semlive-") as folder:
        for _ in simulate(load_scenario(name), Path(folder), None):
            pass
        found = qualify_source(QualifyRequest(Path(folder) / "export", search_effects=search_effects))
    return found.limiting, found.limiting_corrected


def coverage_rows(count: int) -> Iterator[tuple[str, bool]]:
    """Lines of the table of the coverage, each with whether it is good enough."""
    for name, items in coverage(count).items():
        share, true = float(np.mean([item.inside for item in items])), np.array([item.true for item in items])
        error = np.sqrt(np.mean([(item.interval[0] / item.true - 1.0) ** 2 for item in items]))
        half = np.median([0.5 * (item.interval[2] - item.interval[1]) / item.true for item in items])
        size = f"{true.min():.3g} to {true.max():.3g} | {100 * error:.1f} % | {100 * half:.1f} %"
        yield f"| {name} | {100 * share:.0f} % of {len(items)} | {size} |", share * len(items) >= band(len(items))[0]


def scenario_rows(names: Sequence[str]) -> Iterator[tuple[str, bool]]:
    """Lines of the table of the limits, each with whether the limit is named rightly."""
    for name in names:
        found = limiting(name)
        effects = " | ".join(effect.replace("_", " ") for effect in (LIMITING[name], *found))
        yield f"| `{name}` | {effects} |", LIMITING[name] in found


def tensile_rows(count: int) -> Iterator[tuple[str, bool]]:
    """Lines of the table of tensile runs, each with whether the strain noise was predicted well enough."""
    for number in range(count):
        one = compared(number)
        noise, interval = f"{1e6 * one.predicted:.0f}", f"{1e6 * one.low:.0f} to {1e6 * one.high:.0f}"
        error = f"{1e6 * one.found:.0f} | {1e6 * one.constant:.0f} | {one.ratio:.3f}"
        yield f"| {number} | {one.noise_px:.3f} | {noise} | {interval} | {error} |", abs(one.ratio - 1.0) <= MAX_NOISE_ERROR


def protocol_rows(count: int) -> Iterator[tuple[str, bool]]:
    """Lines of the table of protocols, each with whether the recommended one is good enough."""
    for number in range(count):
        one = contest(number, RANDOM_PROTOCOLS)
        errors = " | ".join(f"{1e6 * error:.0f}" for error in (*one.first, one.median))
        both = f"{_protocol(one.recommended)} | {_protocol(one.best)}"
        yield f"| {number} | {one.noise_px:.3f} | {both} | {errors} | {one.ratio:.3f} |", one.ratio <= MAX_PROTOCOL_RATIO


def _protocol(tried: Tried) -> str:
    calibration = len(tried.shifts_px)
    return f"{tried.wait_s:.0f} s, {tried.integrations} x {tried.factor:.2f}, {calibration} + {tried.pairs - calibration}"


def printed(name: str, rows: Iterator[tuple[str, bool]], *, write: bool) -> bool:
    """Print lines as they come, write them into the documentation if there are any, and return whether all are good enough."""
    lines, good = list[str](), True
    for line, line_good in rows:
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
        lines.append(line)
        good &= line_good
    if write and lines:
        begin, end = (f"<!-- bench_qualify {name}: {part} -->" for part in ("begin", "end"))
        before, rest = DOCS.read_text(encoding="utf-8").split(begin)
        heading = rest.split(end)[0].strip().splitlines()[:2]
        DOCS.write_text(before + "\n".join((begin, "", *heading, *lines, "", end)) + rest.split(end)[1], encoding="utf-8")
    return good


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables that are requested; returns the exit code."""
    parser = argparse.ArgumentParser(description="Coverage of intervals, limiting effects, recommended protocols and predicted noise.")
    for name, what in (
        ("microscopes", "that are drawn, rendered and qualified"),
        ("strained", "of these in which a specimen is strained"),
        ("maps", "whose maps are drawn without images"),
        ("tensile", "in which a specimen is strained, without images"),
        ("protocols", "whose recommended protocol is compared"),
    ):
        parser.add_argument(f"--{name}", type=int, default=0, help=f"number of microscopes {what}")
    parser.add_argument("--keep", type=Path, help="folder of the qualified microscopes")
    parser.add_argument("--scenarios", nargs="*", choices=list(LIMITING), help="scenarios; without a name all")
    parser.add_argument("--daemon", nargs="*", choices=list(LIMITING), help="only: scenarios through the daemon; without a name all")
    parser.add_argument("--steps", action="store_true", help="only: further steps with another scan through the daemon")
    parser.add_argument("--write", action="store_true", help="write the tables into the documentation")
    given = parser.parse_args(argv)
    limit_blas_threads()
    if given.daemon is not None:
        return 0 if printed("daemon", daemon_rows(LIMITING, given.daemon or list(LIMITING)), write=given.write) else 1
    if given.steps:
        return 0 if printed("steps", step_rows(), write=given.write) else 1
    counts = (given.microscopes, given.strained, given.maps, given.tensile, given.protocols)
    everything = given.scenarios is None and not any(counts)
    microscopes, loaded, maps, tensile, protocols = EVERYTHING if everything else counts
    drawn = cases(max(microscopes, loaded), given.keep)
    found = drawn[:microscopes]
    tables = {
        "microscopes": microscope_rows(found),
        "named": limit_rows(found) if found else iter(()),
        "further": further_rows(found) if found else iter(()),
        "strained": strained_rows([strained(case) for case in drawn[:loaded]]),
        "coverage": coverage_rows(maps),
        "tensile": tensile_rows(tensile),
        "protocols": protocol_rows(protocols),
        "limits": scenario_rows(list(LIMITING) if everything else [] if given.scenarios is None else given.scenarios or list(LIMITING)),
    }
    return 0 if all([printed(name, rows, write=given.write) for name, rows in tables.items()]) else 1


if __name__ == "__main__":
    sys.exit(main())
