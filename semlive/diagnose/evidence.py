"""Evidence: how much likelier the data are with an effect than without, refitted together with the baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline import Ladder
from semlive.diagnose.prepared import Prepared, Whitened, prepared
from semlive.diagnose.side_by_side import AT_ONCE, side_by_side
from semlive.model.effects import Family

Array = NDArray[np.float64]
SIZES = 6  # that are tried between the least and the largest that is expected
MOST_BYTES = 500_000_000
SAID = 1e-6  # of the largest eigenvalue: sums of a law's columns that the baseline takes whole say nothing


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """A law against the data, for each rung of a ladder.

    Attributes:
        values: (rungs, q) eigenvalues of the law's information.
        vectors: (rungs, q, q) its eigenvectors.
        pull: (rungs, q) what the data ask for, along the eigenvectors.
    """

    values: Array
    vectors: Array
    pull: Array

    @classmethod
    def of(cls, information: Array, pull: Array) -> Projected:
        """From what the baseline leaves of a law's columns (rungs, q, q), and what the data ask of them (rungs, q)."""
        values, vectors = np.linalg.eigh(information)
        return cls(np.clip(values, 0.0, None), vectors, np.einsum("rji,rj->ri", vectors, pull))

    def log_factor(self, sizes_px: Array) -> Array:
        """(rungs, sizes) logarithm of the Bayes factor against no effect, for amplitudes of so many px."""
        return log_factor(self.values[:, None, :], self.pull[:, None, :], sizes_px[:, None])

    def amplitudes(self, rung: int, size_px: float) -> tuple[Array, Array]:
        """(q,) posterior mean and (q, q) covariance of the amplitudes."""
        more = 1.0 / (self.values[rung] + size_px**-2.0)
        vectors = self.vectors[rung]
        return vectors @ (more * self.pull[rung]), (vectors * more) @ vectors.T


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """A family against the data.

    Attributes:
        family: which.
        values: what is not linear, for each law.
        laws: the same laws against the data.
        each: (laws, rungs, sizes) logarithms of the Bayes factors, those of the rungs relative to the whole ladder.
        null: (draws,) logarithm of the family's Bayes factor where there is nothing but the likeliest baseline, where that was asked.
        between: what values between those of the grid add to the logarithm of the Bayes factor, where that was asked.
    """

    family: Family
    values: tuple[dict[str, float], ...]
    laws: tuple[Projected, ...]
    each: Array
    null: Array
    between: float = 0.0

    @property
    def log_factor(self) -> float:
        """Logarithm of the family's Bayes factor: the mean over laws and sizes, every smoothness at its own likelihood."""
        return float(np.logaddexp.reduce(self.each, axis=None) - np.log(self.each.shape[0] * self.each.shape[2])) + self.between

    @property
    def best(self) -> tuple[int, int, int]:
        """Law, rung and size that are likeliest."""
        law, rung, size = np.unravel_index(int(np.argmax(self.each)), self.each.shape)
        return int(law), int(rung), int(size)


def log_factor(values: Array, pull: Array, size_px: Array) -> Array:
    """(...) for eigenvalues and pulls (..., q) of a law and amplitudes of a size: its Bayes factor, amplitudes integrated out."""
    gain = size_px**2
    return np.asarray(0.5 * np.sum(pull**2 * gain / (1.0 + gain * values) - np.log1p(gain * values), axis=-1))


def sizes_of(family: Family) -> Array:
    """(sizes,) amplitudes that are tried, px."""
    return np.geomspace(*family.sizes_px, SIZES)


def projected(ladder: Ladder, field: Array) -> Projected:
    """One law's columns (f, b, 2, q), in px, against the data."""
    return Projected.of(*informed(ladder, field))


def informed(ladder: Ladder, field: Array) -> tuple[Array, Array]:
    """Of columns (f, b, 2, q), in px, (rungs, q, q) what the baseline leaves of them, and (rungs, q) what the data ask of them."""
    white = Whitened.of(ladder, (field,))
    flat = _Flat.of(ladder, white)
    return _left_of(flat, white, 0), flat.pull


def kept_for(ladder: Ladder, families: Sequence[Family], so_far: Mapping[str, Prepared] = MappingProxyType({})) -> dict[str, Prepared]:
    """By the name of each family its laws, whitened: to be asked of the same baseline with more and more effects in it.

    None where they would take more than half a gigabyte.

    Args:
        ladder: the baseline.
        families: whose laws are wanted.
        so_far: what is kept of others.
    """
    scene, found = ladder.design.observation.scene, dict(so_far)
    for first in range(0, len(families), AT_ONCE):
        some = families[first : first + AT_ONCE]
        made = side_by_side(lambda family: prepared(ladder, family, scene), some)
        found |= {family.name: one for family, one in zip(some, made, strict=True) if one is not None}
        if sum(one.nbytes for one in found.values()) > MOST_BYTES:
            return {}
    return found


def weigh(ladder: Ladder, families: Sequence[Family], kept: Mapping[str, Prepared] | None = None) -> tuple[Weighed, ...]:
    """Families against the data; those that cannot be seen here are left out.

    Args:
        ladder: the baseline, with the effects so far.
        families: that are asked.
        kept: `kept_for` the same baseline without the last effects.
    """
    found = side_by_side(lambda family: _weighed(ladder, family, _asked(ladder, family, kept)), families)
    return tuple(one for one in found if one is not None)


def with_draws(
    ladder: Ladder, heard: Sequence[Weighed], draws: NullDraws, kept: Mapping[str, Prepared] | None = None
) -> tuple[Weighed, ...]:
    """Families that were weighed, against draws of the null of the same baseline too; `kept` as for `weigh`."""
    return tuple(side_by_side(lambda one: replace(one, null=_drawn(ladder, one, draws, kept)), heard))


def _asked(ladder: Ladder, family: Family, kept: Mapping[str, Prepared] | None) -> Prepared | None:
    return (kept or {}).get(family.name) or prepared(ladder, family, ladder.design.observation.scene)


def _weighed(ladder: Ladder, family: Family, asked: Prepared | None) -> Weighed | None:
    if asked is None:
        return None
    sizes, base = sizes_of(family), np.array([one.evidence for one in ladder.rungs]) - ladder.evidence
    laws = [law for batch in asked.batches for law in _against(_Flat.of(ladder, batch), batch)]
    factors = np.stack([one.log_factor(sizes) for one in laws]) + base[None, :, None]
    return Weighed(family, asked.values, tuple(laws), factors, np.zeros(0))


def _drawn(ladder: Ladder, one: Weighed, draws: NullDraws, kept: Mapping[str, Prepared] | None) -> Array:
    """(draws,) logarithm of a family's Bayes factor at the likeliest rung."""
    asked, sizes, rung, laws = _asked(ladder, one.family, kept), sizes_of(one.family), ladder.rungs.index(ladder.best), iter(one.laws)
    assert asked is not None  # it was weighed
    null = []
    for batch in asked.batches:
        drawn = draws.pull(batch, ladder.best.half(batch.shared_with(ladder.design)))
        for own in batch.spans:
            law = next(laws)
            gains = np.outer(sizes**2, law.values[rung])
            fit = (drawn[:, own] @ law.vectors[rung]) ** 2 @ (sizes[:, None] ** 2 / (1.0 + gains)).T
            null.append(0.5 * (fit - np.log1p(gains).sum(axis=1)))
    return np.asarray(np.logaddexp.reduce(np.stack(null), axis=(0, 2)) - np.log(len(null) * len(sizes)))


@dataclass(frozen=True, slots=True, eq=False)
class _Flat:
    """Whitened columns against the baseline.

    Attributes:
        halves: for each rung, what the baseline has in common with the columns, half solved.
        pull: (rungs, q) what the data ask for.
    """

    halves: tuple[Array, ...]
    pull: Array

    @classmethod
    def of(cls, ladder: Ladder, white: Whitened) -> _Flat:
        """For all rungs of a ladder."""
        shared = white.shared_with(ladder.design)
        halves = tuple(rung.half(shared) for rung in ladder.rungs)
        return cls(halves, np.stack([white.asked - half.T @ rung.asked for rung, half in zip(ladder.rungs, halves, strict=True)]))


def _against(flat: _Flat, white: Whitened) -> tuple[Projected, ...]:
    """Each law."""
    return tuple(Projected.of(_left_of(flat, white, law), flat.pull[:, own]) for law, own in enumerate(white.spans))


def _left_of(flat: _Flat, white: Whitened, law: int) -> Array:
    """(rungs, q, q) what the baseline leaves of a law's columns."""
    own, alone = white.spans[law], white.alone[law]
    return np.stack([alone - one[:, own].T @ one[:, own] for one in flat.halves])


def left_in_common(ladder: Ladder, field: Array) -> Array:
    """(q, q) products of columns (f, b, 2, q), in px, with each other: of what the likeliest baseline leaves of them."""
    white = Whitened.of(ladder, (field,))
    flat = _Flat.of(Ladder(ladder.design, ladder.left, (ladder.best,)), white)
    return white.alone[0] - flat.halves[0].T @ flat.halves[0]


def pulled(ladder: Ladder, field: Array) -> Array:
    """(q,) what the data ask of columns (f, b, 2, q), in px, at the likeliest baseline."""
    return np.asarray(_Flat.of(Ladder(ladder.design, ladder.left, (ladder.best,)), Whitened.of(ladder, (field,))).pull[0])


def overlap(ladder: Ladder, field: Array, law: Array) -> float:
    """Share of a field (f, b, 2) that a law's columns (f, b, 2, q) have too, of what the likeliest baseline leaves of both."""
    both = left_in_common(ladder, np.concatenate((field[..., None], law), axis=-1))
    values, vectors = np.linalg.eigh(both[1:, 1:])
    told = values > SAID * values[-1]
    along = vectors[:, told].T @ both[1:, 0]
    return float(np.clip(np.sum(along**2 / values[told]) / both[0, 0], 0.0, 1.0)) if both[0, 0] > 0.0 and told.any() else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class NullDraws:
    """Data as the likeliest baseline would make them, with nothing hidden in them: a parametric bootstrap.

    Attributes:
        noise: for x and for y, (f b, draws) whitened noise.
        asked: (p, draws) what noise and belief ask of the baseline, half solved.
    """

    noise: tuple[Array, Array]
    asked: Array

    @classmethod
    def of(cls, ladder: Ladder, draws: int, seed: int) -> NullDraws:
        """So many draws.

        With parameters m drawn as they are believed, ``y = A m + e``, the baseline's refit leaves ``Z^T e - S^T (A^T e - L xi)`` of a
        law's columns Z, L L^T being the prior's precision and S the posterior covariance times A^T Z: nothing of m itself.
        """
        rng = np.random.default_rng((seed, 41))
        f, b = ladder.design.observation.frames, ladder.design.observation.blocks
        noise = rng.normal(size=(f, b, 2, draws))
        noise -= noise.mean(axis=0)
        believed = np.linalg.cholesky(ladder.best.prior) @ rng.normal(size=(ladder.design.size, draws))
        asked = ladder.best.half(ladder.design.transposed(noise) - believed)
        flat = noise[:, :, 0].reshape(-1, draws), noise[:, :, 1].reshape(-1, draws)
        return cls(flat, asked)

    def pull(self, white: Whitened, half: Array) -> Array:
        """(draws, q) what each draw asks of columns that have so much, half solved, in common with the likeliest baseline."""
        return (white.along(self.noise) - half.T @ self.asked).T


def projected_with_draws(ladder: Ladder, field: Array, draws: NullDraws) -> tuple[Array, Array, Array]:
    """(q,) eigenvalues, ascending, (q,) pull of the data and (draws, q) of the null for columns in px, at the likeliest rung."""
    white = Whitened.of(ladder, (field,))
    flat = _Flat.of(replace(ladder, rungs=(ladder.best,)), white)
    (all_of_it,) = _against(flat, white)
    return all_of_it.values[0], all_of_it.pull[0], draws.pull(white, flat.halves[0]) @ all_of_it.vectors[0]
