"""Cases of the benchmark: what is hidden in each, known to the scorer alone, and the data, known to diagnosis alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import cache

import numpy as np
from blind.deformed import DEFORMED, deformed
from blind.experiment import Conditions, beyond_shear_px, largest_px
from blind.hiding import DETECTABLE_PX, PHYSICAL_PX, hidden_constants, hidden_effect, hidden_values, jump_frame
from blind.nuisance import ANY_SIZE, GRIDS, under
from blind.observing import observed
from blind.strange import STRANGE
from numexp.noise import NoiseKind

from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.diagnose.baseline.observation import Observation
from semlive.model.effects import EFFECT_CLASSES, EffectClass
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.library import LIBRARY
from semlive_simulators.effects.scan_timing import WrongRowTime
from semlive_simulators.effects.specimen_motion import DriftJump

GRID = Grid(101, 101, 15, 50, 40, 43)
"""Every third point of the usual grid: its block means differ by less than their noise, and cases are made in half the time."""
SHORT_PAIRS = (6, 5)
"""Pairs of the cross and pairs under load, of 8 and 7."""
FIRST_SEED = {"development": 1, "final": 100_001, "calibration": 200_001, "nuisance": 300_001}
"""Nothing may be chosen by the results of the final set."""
WIDEST = 1.0
"""Error of a row time: the largest in the catalogue. Where the drift's rate hardly varies maps show little even of that."""
NOTHING, ONE, TWO, UNLISTED = "nothing", "one", "two", "stranger"
DEFORMED_LAW, REMOVED, CONFOUNDED = "deformed", "left out", "confounded"
SWALLOWED = (  # by the distortion, the gauge, the free strain or the drift: one experiment cannot separate them from these
    "flyback_settling", "frame_start_settling", "line_sync_hum", "scan_nonlinearity", "anisotropic_pixel", "scan_nonorthogonality",
    "out_of_plane_translation", "inplane_misalignment", "warmup_transient", "random_walk_drift",
)  # fmt: skip
SEPARABLE = (  # their fields have nothing in common outside of the baseline
    ("magnification_drift", "tilt_with_load"),
    ("raster_rotation_drift", "bending_misalignment"),
    ("thermal_oscillation", "refocus_magnification_step"),
    ("drift_jump", "distortion_scale_drift"),
    ("charging_local_lens", "stage_yaw"),
    ("stage_step_transient", "magnification_drift"),
)


@dataclass(frozen=True, slots=True)
class Case:
    """What is hidden.

    Attributes:
        kind: nothing; one, or two; an unlisted effect; one with a deformed model; one removed from the dictionary; a confounded one.
        names: of what is hidden.
        size: times what can be detected; px of an unlisted effect; what is confounded is as large as the library has it at x200.
        seed: of everything.
        white: whether points share no noise and none is lost or wrong.
        under: a nuisance that the usual cases do not have, or nothing.
        noise_ratio: noise relative to that for which detection limits are stated; the limits are proportional to it.
    """

    kind: str
    names: tuple[str, ...]
    size: float
    seed: int
    white: bool = False
    under: str = ""
    noise_ratio: float = 1.0

    @property
    def key(self) -> str:
        """Key of its data and verdict; reveals nothing of the hidden effect."""
        fields = {
            name: value for name, value in asdict(self).items() if name != "noise_ratio" and (name not in ("white", "under") or value)
        }
        return hashlib.sha256(b"semlive blind, sizes as they can be detected " + json.dumps(fields).encode()).hexdigest()[:16]

    def effects(self) -> tuple[Effect, ...]:
        """What is hidden."""
        return _effects(self)

    def sized(self) -> tuple[Effect, ...]:
        """The same, without the cache."""
        if self.kind == UNLISTED:
            return (self._unlisted_effect(),)
        if self.kind == CONFOUNDED:
            return (LIBRARY[self.names[0]].defaults("x200"),)
        return tuple(self._effect(name, self._peak_px(name)) for name in self.names)

    def _peak_px(self, name: str) -> float:
        if self.under != ANY_SIZE:
            return peak_px(name, self.size * self.noise_ratio)
        least, largest = np.log(np.maximum(PHYSICAL_PX[name], 1e-3))
        return float(np.exp(np.random.default_rng((self.seed, 79, tuple(DETECTABLE_PX).index(name))).uniform(least, largest)))

    @property
    def detectable(self) -> bool:
        """Whether each effect is at least four times as large as can be detected; sizes that are drawn may not be."""
        return self.under != ANY_SIZE or all(self._peak_px(name) >= 4.0 * DETECTABLE_PX[name] for name in self.names)

    def _unlisted_effect(self) -> Effect:
        kind = STRANGE[self.names[0]]
        return kind(self.size**2 / largest_px(self.conditions(), (kind(self.size, self.seed),)), self.seed)

    def _effect(self, name: str, peak_px: float) -> Effect:
        """As large in the maps as asked for: displacements grow with an effect's size; no row takes more than twice what is stated."""
        near = self._lawful(name, peak_px)
        found = self._lawful(name, peak_px * peak_px / largest_px(self.conditions(), (near,)))
        return WrongRowTime(min(found.row_time_error, WIDEST)) if isinstance(found, WrongRowTime) else found

    def _lawful(self, name: str, peak_px: float) -> Effect:
        (effect,) = hidden_effect(name, peak_px, self.seed)
        if isinstance(effect, DriftJump) and self.under:
            effect = replace(effect, at_s=self._jump_s())
        return deformed(effect) if self.kind == DEFORMED_LAW else effect

    def _jump_s(self) -> float:
        """Instant of a jump at the same rows as in the usual cases; between frames it is a rigid motion, which no map can show."""
        (frame, fraction), conditions = jump_frame(self.seed), self.conditions()
        return conditions.begin_s(frame) + fraction * conditions.scan.frame_time_s

    @property
    def faint(self) -> bool:
        """Whether the largest that is met is below twice what can be detected: a wrong row time, where the drift's rate hardly varies."""
        if (self.kind, self.names) != (ONE, ("wrong_row_time",)):
            return False
        return _is_faint(self)

    @property
    def sheared(self) -> bool:
        """Whether less than can be detected sets it apart from a shear that drifts: a wrong row time, where the drift along y is steady."""
        return (self.kind, self.names) == (ONE, ("wrong_row_time",)) and _like_a_shear(self)

    def truth(self) -> dict[str, dict[str, float]]:
        """What diagnosis should report of each effect."""
        if self.kind in (UNLISTED, CONFOUNDED, DEFORMED_LAW):
            return {name: {} for name in self.names}
        return {name: hidden_values(name, one) for name, one in zip(self.names, self.effects(), strict=True)}

    def constants(self) -> dict[str, float]:
        """Nonlinear parameters of a single effect."""
        return hidden_constants(self.names[0], self.effects()[0]) if self.kind == ONE else {}

    def conditions(self) -> Conditions:
        """As they are stated for sizes that can be detected; where nothing is hidden they vary."""
        shared = under(self.under, self._shared())
        return replace(shared, kind=NoiseKind.WHITE, missing=0.0, outliers=0.0) if self.white else shared

    def _shared(self) -> Conditions:
        if self.kind != NOTHING:
            return Conditions(self.seed)
        rng = np.random.default_rng((self.seed, 77))
        return Conditions(
            self.seed,
            calibration=int(rng.integers(5, 9)),
            tension=int(rng.integers(3, 8)),
            noise_px=float(rng.uniform(0.01, 0.03)),
            missing=float(rng.uniform(0.0, 0.03)),
            outliers=float(rng.uniform(0.0, 0.003)),
        )

    def dictionary(self) -> tuple[EffectClass, ...]:
        """The effects in the dictionary of diagnosis."""
        return tuple(one for one in EFFECT_CLASSES if self.kind != REMOVED or one.name not in self.names)

    def observed(self, grid: Grid = GRID, settings: EstimateSettings | None = None) -> Observation:
        """The data."""
        return observed(self.conditions(), self.effects(), GRIDS.get(self.under, grid), settings)

    def shortened(self, grid: Grid = GRID, settings: EstimateSettings | None = None) -> Observation:
        """For tests: the same in a run of fewer pairs, whose verdict takes half the time."""
        conditions = replace(self.conditions(), calibration=SHORT_PAIRS[0], tension=SHORT_PAIRS[1])
        return observed(conditions, self.effects(), grid, settings)


@cache  # a size is found by two simulations of the complete experiment
def _effects(case: Case) -> tuple[Effect, ...]:
    return case.sized()


@cache
def _is_faint(case: Case) -> bool:
    return largest_px(case.conditions(), (WrongRowTime(WIDEST),)) < 2.0 * case.noise_ratio * DETECTABLE_PX["wrong_row_time"]


@cache
def _like_a_shear(case: Case) -> bool:
    return beyond_shear_px(case.conditions(), case.effects()) < case.noise_ratio * DETECTABLE_PX[case.names[0]]


def peak_px(name: str, size: float) -> float:
    """The largest displacement of an effect of such a size: never larger than is met at x200, but twice what can be detected at least."""
    least_px = DETECTABLE_PX[name]
    return min(size * least_px, max(PHYSICAL_PX[name][1], 2.0 * least_px))


@dataclass(frozen=True, slots=True)
class Counts:
    """How many cases of each kind: of nothing and of two effects in all, else of each name."""

    seeds: int
    nulls: int = 0
    doubles: int = 0
    strange: int = 0
    deformed: int = 0
    removed: int = 0
    confounded: int = 0


def cases(which: str, counts: Counts, sizes: Sequence[float], names: Sequence[str]) -> Iterator[Case]:
    """Cases in an order in which each part of the list holds cases of every kind.

    Args:
        which: development or final.
        counts: how many; two effects, deformed models and removed effects come at eight times.
        sizes: of single effects, times what can be detected.
        names: of single effects.
    """
    first, nulls = FIRST_SEED[which], counts.nulls
    for number in range(max(astuple(counts))):
        if number < counts.seeds:
            for size in sizes:
                for name in names:
                    yield Case(ONE, (name,), size, first + number)
        each = max(1, -(-nulls // max(counts.seeds, 1)))
        for null in range(number * each, min((number + 1) * each, nulls)):
            yield Case(NOTHING, (), 0.0, first + 5000 + null)
        if number < counts.doubles:
            yield Case(TWO, SEPARABLE[number % len(SEPARABLE)], 8.0, first + 3000 + number)
        if number < counts.strange:
            for name in STRANGE:
                for size_px in (0.03, 0.1):
                    yield Case(UNLISTED, (name,), size_px, first + 4000 + number)
        for kind, count, effect_names in (
            (DEFORMED_LAW, counts.deformed, DEFORMED),
            (REMOVED, counts.removed, tuple(DETECTABLE_PX)),
            (CONFOUNDED, counts.confounded, SWALLOWED),
        ):
            for name in effect_names if number < count else ():
                yield Case(kind, (name,), 1.0 if kind == CONFOUNDED else 8.0, first + 2000 + number)
