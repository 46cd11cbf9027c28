"""Evidence: how much likelier the data are with an effect than without, refitted together with the baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline import Ladder
from semlive.model.effects import Family, Law

Array = NDArray[np.float64]
SIZES = 6  # that are tried between the least and the largest that is expected
COLUMNS_AT_ONCE = 256
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
        null: (draws,) logarithm of the family's Bayes factor where there is nothing but the likeliest baseline.
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
    return _against(_Flat.of(ladder, field), slice(0, field.shape[-1]))


def weigh(ladder: Ladder, families: Sequence[Family], draws: NullDraws | None) -> tuple[Weighed, ...]:
    """Families against the data, and against draws of the null; those that cannot be seen here are left out."""
    scene = ladder.design.observation.scene
    found = []
    for family in families:
        told = [(dict(values), family.law(scene, values)) for values in family.grid(scene)]
        seen = [(values, law) for values, law in told if law is not None]
        if seen:
            found.append(_weighed(ladder, family, seen, draws))
    return tuple(found)


def _weighed(ladder: Ladder, family: Family, seen: Sequence[tuple[dict[str, float], Law]], draws: NullDraws | None) -> Weighed:
    sizes, base = sizes_of(family), np.array([one.evidence for one in ladder.rungs]) - ladder.evidence
    laws, null = [], []
    each = max(1, COLUMNS_AT_ONCE // seen[0][1].field_px.shape[-1])
    for first in range(0, len(seen), each):
        batch = [law.field_px for _, law in seen[first : first + each]]
        flat = _Flat.of(ladder, np.concatenate(batch, axis=-1))
        asked = None if draws is None else draws.pull(flat)
        at = 0
        for one in batch:
            own = slice(at, at + one.shape[-1])
            laws.append(_against(flat, own))
            if asked is not None:
                rung = ladder.rungs.index(ladder.best)
                along = asked[:, own] @ laws[-1].vectors[rung]
                null.append(log_factor(laws[-1].values[rung][None, None], along[:, None], sizes[:, None]))
            at = own.stop
    factors = np.stack([one.log_factor(sizes) for one in laws]) + base[None, :, None]
    drawn = np.logaddexp.reduce(np.stack(null), axis=(0, 2)) - np.log(len(null) * len(sizes)) if null else np.zeros(0)
    return Weighed(family, tuple(values for values, _ in seen), tuple(laws), factors, drawn)


@dataclass(frozen=True, slots=True, eq=False)
class _Flat:
    """Whitened columns against the baseline; most move things along one axis only, and are held for that axis alone.

    Attributes:
        index: for x and for y, the columns that move things along it.
        columns: for x and for y, (f b, their number).
        halves: for each rung, what the baseline has in common with the columns, half solved.
        pull: (rungs, q) what the data ask for.
    """

    index: tuple[NDArray[np.int64], NDArray[np.int64]]
    columns: tuple[Array, Array]
    halves: tuple[Array, ...]
    pull: Array

    @classmethod
    def of(cls, ladder: Ladder, field: Array) -> _Flat:
        """Columns (f, b, 2, q) in px."""
        design, q = ladder.design, field.shape[-1]
        index, columns = [], []
        shared, asked = np.zeros((design.size, q)), np.zeros(q)
        for axis in (0, 1):
            there = np.flatnonzero(field[:, :, axis].any(axis=(0, 1)))
            white = design.whiten(field[:, :, axis, there]).reshape(design.observation.frames * design.observation.blocks, len(there))
            shared[np.ix_(design.index[axis], there)] += design.columns[axis].T @ white
            asked[there] += white.T @ ladder.left[:, :, axis].ravel()
            index.append(there)
            columns.append(white)
        halves = tuple(rung.half(shared) for rung in ladder.rungs)
        pull = np.stack([asked - half.T @ rung.asked for rung, half in zip(ladder.rungs, halves, strict=True)])
        return cls((index[0], index[1]), (columns[0], columns[1]), halves, pull)

    def along(self, noise: tuple[Array, Array]) -> Array:
        """(q, draws) columns times whitened noise, (f b, draws) for x and for y."""
        total = np.zeros((self.pull.shape[1], noise[0].shape[1]))
        for there, columns, one in zip(self.index, self.columns, noise, strict=True):
            total[there] += columns.T @ one
        return total

    def among(self, own: slice) -> Array:
        """Products of some of the columns with each other."""
        total = np.zeros((own.stop - own.start,) * 2)
        for there, columns in zip(self.index, self.columns, strict=True):
            low, high = np.searchsorted(there, (own.start, own.stop))
            at = there[low:high] - own.start
            total[np.ix_(at, at)] += columns[:, low:high].T @ columns[:, low:high]
        return total


def _against(flat: _Flat, own: slice) -> Projected:
    alone = flat.among(own)
    left = [alone - one[:, own].T @ one[:, own] for one in flat.halves]
    value, vectors = np.linalg.eigh(np.stack(left))
    return Projected(np.clip(value, 0.0, None), vectors, np.einsum("rji,rj->ri", vectors, flat.pull[:, own]))


def left_in_common(ladder: Ladder, field: Array) -> Array:
    """(q, q) products of columns (f, b, 2, q), in px, with each other: of what the likeliest baseline leaves of them."""
    flat = _Flat.of(Ladder(ladder.design, ladder.left, (ladder.best,)), field)
    return flat.among(slice(0, field.shape[-1])) - flat.halves[0].T @ flat.halves[0]


def pulled(ladder: Ladder, field: Array) -> Array:
    """(q,) what the data ask of columns (f, b, 2, q), in px, at the likeliest baseline."""
    return np.asarray(_Flat.of(Ladder(ladder.design, ladder.left, (ladder.best,)), field).pull[0])


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
        rung: of the likeliest baseline in its ladder.
        noise: for x and for y, (f b, draws) whitened noise.
        asked: (p, draws) what noise and belief ask of the baseline, half solved.
    """

    rung: int
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
        return cls(ladder.rungs.index(ladder.best), flat, asked)

    def pull(self, flat: _Flat) -> Array:
        """(draws, q) what each draw asks of columns."""
        return (flat.along(self.noise) - flat.halves[self.rung].T @ self.asked).T


def projected_with_draws(ladder: Ladder, field: Array, draws: NullDraws) -> tuple[Array, Array, Array]:
    """(q,) eigenvalues, ascending, (q,) pull of the data and (draws, q) of the null for columns in px, at the likeliest rung."""
    flat = _Flat.of(ladder, field)
    all_of_it = _against(flat, slice(0, field.shape[-1]))
    return all_of_it.values[draws.rung], all_of_it.pull[draws.rung], draws.pull(flat) @ all_of_it.vectors[draws.rung]
