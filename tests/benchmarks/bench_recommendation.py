"""Noise that `dic.recommend` predicts from one frame, against repeated exposures.

    python tests/benchmarks/bench_recommendation.py [--write]
    python tests/benchmarks/bench_recommendation.py --real ../shared/real

Each rendered texture is exposed several times with other noise in both frames, and correlated with the recommended subset and step.
Observed: standard deviation over the exposures of u, v and of the strain of the recommended gauge, median over the field. With
`--real FOLDER` the recommendation for the first frame of each pair is printed with the scatter of the measured displacement. `--write` puts
the first table into docs/validation/correlation.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import cv2
import numpy as np
from numpy.typing import NDArray
from paper import write_between
from rasters.scenes import DISTURBANCES, TEXTURES, Scene, render
from scipy.special import gammaincinv

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.data.settings import DicSettings, StrainSettings
from semlive.data.strain import Displacement
from semlive.errors import BadInput
from semlive.mechanics import strain
from semlive.service.planning.recommendation import Recommendation, recommendation

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "correlation.md"
SETTINGS, WINDOW_POINTS = DicSettings(roi_px=None), 9
SHOWN = ("none", "weak contrast", "shot noise")
COMPONENTS = ("u", "v", "exx", "eyy", "exy")
PAIRS = tuple(f"{name}: predicted / observed" for name in COMPONENTS)
HEADINGS = ("texture", "noise", "method", "subset / step px", *PAIRS, "points measured %")


@dataclass(frozen=True, slots=True)
class Repeats:
    """Noise of repeated exposures of a scene.

    Attributes:
        recommended: the recommendation for its first frame.
        predicted: standard deviation of u, v (px), exx, eyy, exy.
        observed: the same over the exposures.
        measured: fraction of the points that stay in the frame that converged.
    """

    recommended: Recommendation
    predicted: tuple[float, ...]
    observed: tuple[float, ...]
    measured: float


def repeats(s: Scene, count: int, seed: int = 1) -> Repeats:
    """Expose a scene `count` times and correlate it as recommended."""
    found = recommendation(s.first, SETTINGS, WINDOW_POINTS, StrainSettings())
    choice, gauge = found.choice, found.gauge
    assert gauge is not None
    settings = replace(SETTINGS, subset_px=choice.subset_px, step_px=choice.step_px)
    draws, measured = [], []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        first, second = (optics.noise.expose(clean, rng) for optics, clean in zip(s.optics, (s.clean_first, s.clean_second), strict=True))
        m = dic.match(first, second, settings=settings)
        measured.append(m.valid[m.status != PoiStatus.OUTSIDE_IMAGE].mean())
        field = strain(Displacement(1, m.grid, m.u_px, m.v_px, m.sigma_u_px, m.sigma_v_px, m.valid), gauge.window_points)
        parts = [(m.u_px, m.valid), (m.v_px, m.valid), *((getattr(field, name), field.valid) for name in COMPONENTS[2:])]
        draws.append([np.where(valid, values, np.nan) for values, valid in parts])
    edge = gauge.window_points // 2  # of complete gauges
    observed = []
    for k, name in enumerate(COMPONENTS):
        part = np.stack([draw[k] for draw in draws])
        part = part if name in "uv" else part[:, edge:-edge, edge:-edge]
        variance = np.var(part, axis=0, ddof=1)
        # Median of a variance that is estimated from so few exposures, relative to its mean.
        middle = 2.0 * gammaincinv(0.5 * (count - 1), 0.5) / (count - 1)
        observed.append(float(np.sqrt(np.nanmedian(variance) / middle)) if np.isfinite(variance).any() else 0.0)
    sigma = gauge.sigma
    predicted = (choice.sigma_u_px, choice.sigma_v_px, sigma.exx, sigma.eyy, sigma.exy)
    return Repeats(found, predicted, tuple(observed), float(np.mean(measured)))


def _row(texture: str, noise: str, r: Repeats) -> str:
    choice = r.recommended.choice
    cells = [f"{p:.2g} / {o:.2g}" if o else f"{p:.2g} / -" for p, o in zip(r.predicted, r.observed, strict=True)]
    parts = (texture, noise, choice.method, f"{choice.subset_px} / {choice.step_px}", *cells, f"{100 * r.measured:.0f}")
    return f"| {' | '.join(parts)} |"


def scatter_px(values: NDArray, valid: NDArray[np.bool_], lag: int) -> float:
    """Robust standard deviation of one value from second differences along x over `lag` points, whose subsets do not overlap."""
    left, centre, right = values[:, : -2 * lag], values[:, lag:-lag], values[:, 2 * lag :]
    usable = valid[:, : -2 * lag] & valid[:, lag:-lag] & valid[:, 2 * lag :]
    if usable.sum() < 20:
        return float("nan")
    return float(np.median(np.abs((left - 2.0 * centre + right)[usable]))) / (0.6745 * 6.0**0.5)


def real(folder: Path) -> None:
    """Print what is recommended for real frames, and the scatter of pairs."""
    pairs = [path.stem.split("__") for path in sorted(folder.glob("*__*.csv"))]
    for first, second in pairs:
        images = [cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_UNCHANGED) for name in (first, second)]
        found = recommendation(np.asarray(images[0]), SETTINGS, WINDOW_POINTS, StrainSettings())
        choice = found.choice
        settings = replace(SETTINGS, subset_px=choice.subset_px, step_px=choice.step_px)
        try:
            m = dic.match(np.asarray(images[0]), np.asarray(images[1]), settings=settings)
        except BadInput as error:
            sys.stdout.write(f"{first}: {error}\n")
            continue
        lag = -(-choice.subset_px // choice.step_px)
        u, v = (scatter_px(values, m.valid, lag) for values in (m.u_px, m.v_px))
        sys.stdout.write(
            f"{first}: {choice.method}, subset {choice.subset_px} px; {choice.reason}; noise predicted {choice.sigma_u_px:.4f} "
            f"{choice.sigma_v_px:.4f} px, scatter {u:.4f} {v:.4f} px, measured {100 * m.valid.mean():.0f} %\n"
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=8, help="exposures of each scene")
    parser.add_argument("--real", type=Path, help="folder of real raster pairs")
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/correlation.md")
    given = parser.parse_args(arguments)
    if given.real is not None:
        real(given.real)
        return
    lines = [f"| {' | '.join(HEADINGS)} |", "|" + "---|" * len(HEADINGS)]
    for texture in TEXTURES:
        for name in SHOWN:
            lines.append(_row(texture, name, repeats(render(texture, DISTURBANCES[name], name, 0), given.count)))
            sys.stdout.write(lines[-1] + "\n")
            sys.stdout.flush()
    if given.write:
        PAGE.write_text(write_between(PAGE.read_text(encoding="utf-8"), "recommendation", "\n".join(lines)), encoding="utf-8")


if __name__ == "__main__":
    main()
