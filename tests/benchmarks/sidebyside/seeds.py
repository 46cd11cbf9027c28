"""The same experiment with other noise: what of one run's table is chance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from sidebyside import facts
from sidebyside.measure import COMPONENTS, GaugeRow, RunFigures
from sidebyside.table import DISPLACEMENTS, correction_share, pooled, strain_text


@dataclass(frozen=True)
class SeedRow:
    """One quantity of every seed, in their order, and of all of them together."""

    quantity: str
    each: tuple[str, ...]
    together: str
    bar: str
    held: bool

    def markdown(self) -> str:
        return f"| {self.quantity} | {' | '.join(self.each)} | {self.together} | {self.bar} **{'held' if self.held else 'missed'}** |"


def seeds_markdown(seeds: tuple[str, ...], runs: tuple[RunFigures, ...]) -> str:
    """The table, one column a seed."""
    head = f"| quantity | {' | '.join(f'seed {name}' for name in seeds)} | together | bar |\n|{'---|' * (len(seeds) + 3)}"
    return "\n".join([head, *(row.markdown() for row in seed_rows(runs))])


def seed_rows(runs: tuple[RunFigures, ...]) -> Iterator[SeedRow]:
    """Scatter and the correction's share are root mean squares over the seeds, elastic constants and their bars are of the mean."""
    for label, names in (("displacement", DISPLACEMENTS), ("strain", COMPONENTS)):
        yield _worst_ratio(label, names, runs)
    at = next(i for i, row in enumerate(_any_curve(runs)) if row.window_points == facts.STATED_WINDOW)
    yield _share("all frames", [correction_share(run) for run in runs])
    for phase in runs[0].phases:
        yield _share(phase, [run.phases[phase].curve[at].correction for run in runs])
    yield _elastic("Young's modulus (GPa)", runs, 0, facts.MODULUS_BAR_GPA, 2)
    yield _elastic("Poisson's ratio", runs, 1, facts.RATIO_OF_POISSON_BAR, 4)


def _worst_ratio(label: str, names: tuple[str, ...], runs: tuple[RunFigures, ...]) -> SeedRow:
    curve = _any_curve(runs)
    places = [at for at, row in enumerate(curve) if row.window_points in facts.CURVE_WINDOWS]
    found = np.array([[(item.measured**2, item.predicted**2) for item in (pooled(run, at, names) for at in places)] for run in runs])
    each = np.sqrt(found[..., 0] / found[..., 1])
    together = np.sqrt(found[..., 0].sum(axis=0) / found[..., 1].sum(axis=0))
    worst = int(together.argmax())
    chance = pooled(runs[0], places[worst], names).chance / np.sqrt(len(runs))
    return SeedRow(
        f"{label} sd against DIC noise, worst over the curve of gauge lengths",
        tuple(f"{item.max():.3f}" for item in each),
        f"{together[worst]:.3f} ± {chance:.3f} by chance, at {curve[places[worst]].vsg_px} px",
        f"≤ {facts.RATIO_BAR}",
        bool(together.max() <= facts.RATIO_BAR),
    )


def _share(frames: str, runs: Sequence[dict[str, float]]) -> SeedRow:
    each = np.array([[run[name] for name in COMPONENTS] for run in runs])
    together = float(np.sqrt((each**2).mean(axis=0)).max())
    return SeedRow(
        f"contribution of the correction to strain sd over 83 px, {frames}",
        tuple(strain_text(item.max()) for item in each),
        strain_text(together),
        f"≤ {strain_text(facts.CORRECTION_SD_BAR)}",
        together <= facts.CORRECTION_SD_BAR,
    )


def _any_curve(runs: tuple[RunFigures, ...]) -> tuple[GaugeRow, ...]:
    return next(iter(runs[0].phases.values())).curve


def _elastic(label: str, runs: tuple[RunFigures, ...], which: int, bar: float, digits: int) -> SeedRow:
    constants = [item.elastic for item in runs]
    values = [(item.youngs_modulus_gpa, item.poissons_ratio)[which] for item in constants if item is not None]
    if len(values) < len(runs):
        return SeedRow(label, tuple("none" for _ in runs), "none", f"within {bar}", held=False)
    mean = float(np.mean([item.value for item in values]))
    sigma = float(np.sqrt(np.sum([item.sigma**2 for item in values])) / len(values))
    true = runs[0].true_elastic[which]

    def shown(value: float) -> str:
        return f"{value:.{digits}f}"

    return SeedRow(
        label,
        tuple(f"{shown(item.value)} ± {shown(item.sigma)}" for item in values),
        f"{shown(mean)} ± {shown(sigma)} (true {true})",
        f"within {bar}",
        abs(mean - true) <= bar,
    )
