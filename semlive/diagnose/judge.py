"""The verdict: detected, adequate, unique, useful; in this order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis import Diagnosis, Disagreement, Experiment, FoundEffect, Gap, KnownEffect, Outcome
from semlive.diagnose.anew import Coupled, beside, likelier_coupled
from semlive.diagnose.baseline import Ladder
from semlive.diagnose.course import likelier_course
from semlive.diagnose.evidence import NullDraws, Weighed, overlap
from semlive.diagnose.gap import gap_of
from semlive.diagnose.heard import Heard
from semlive.diagnose.named import LOUD, ODDS, Named
from semlive.diagnose.observation import Observation
from semlive.diagnose.pictures import pictures_of
from semlive.diagnose.refine import Refined, together
from semlive.diagnose.search import MOST, NAMELESS, Search, searched
from semlive.diagnose.strain_safety import HARMLESS, eaten
from semlive.diagnose.unknown import UNNAMED
from semlive.diagnose.where import where
from semlive.errors import IllPosed
from semlive.model.effects import DICTIONARY, Family

Array = NDArray[np.float64]
DRAWS = 299
# Most of a gap; see `_useful`.
HALF = 0.5
LITTLE = 0.1  # of a block's noise


def diagnose(
    observation: Observation,
    seed: int = 0,
    dictionary: Sequence[Family] = DICTIONARY,
    draws: int = DRAWS,
    known: Sequence[KnownEffect] = (),
) -> Diagnosis:
    """Find where model and data disagree, and what is missing.

    Args:
        observation: of a run.
        seed: of the draws of the null.
        dictionary: the effects that have a name.
        draws: of the null.
        known: effects that the model has already; their amplitudes are refitted, and they are not looked for.

    Raises:
        IllPosed: the data are too few to name anything.
        BadInput: a known effect has no such name, or cannot be in these data.
    """
    families = [one for one in dictionary if one.name not in {item.name for item in known}]
    look = Look.at(likelier_coupled(observation, (*families, *UNNAMED), known), families, known, (draws, seed))
    if look.unsettled:
        look = _looked_again(look, families, known, (draws, seed))
    bare, having, named = look.found.bare, look.having, look.named
    gap = gap_of(bare, having, seed) if named else None
    shares = eaten(having, look.fields, len(known))[len(known) :]
    width, height = (2.0 * observation.state.centre_px + 1.0).round().astype(int).tolist()
    verdict = _verdict(named, look.loud, gap, look.places, bare, shares)
    names, fields = [one.names[0] for one in named], [one.refined.field_px for one in named]
    pictures = pictures_of(bare, having, names, fields) if named else None
    shared = _overlaps(bare, named[0].refined, look.found.first) if named else ()
    verdict = replace(verdict, pictures=pictures, evidence=_told(look.found.first), overlap=shared, coarse=look.found.coarse)
    return replace(verdict, known=tuple(known), end_s=observation.scene.end_s, size_px=(width, height))


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What a search about one point of linearisation found.

    Attributes:
        places: where model and data disagree, before anything was named.
        found: the search.
        having: the baseline with all effects.
        named: they, refitted beside each other.
        fields: of each effect, those that were known first, (f, b, 2, q) what unit amplitudes move, px.
        loud: whether something is left, or what was named does not go as its laws say.
    """

    places: tuple[Disagreement, ...]
    found: Search
    having: Ladder
    named: tuple[Named, ...]
    fields: tuple[Array, ...]
    loud: bool

    @classmethod
    def at(cls, run: Coupled, families: Sequence[Family], known: Sequence[KnownEffect], draws: tuple[int, int]) -> Look:
        """Search; so many draws of the null, and the seed of these."""
        begun = run.heard or Heard.of(run.observation, (*families, *UNNAMED), known)
        null = NullDraws.of(begun.bare, *draws)
        places, found = where(begun.bare, null), searched(begun, families, null, draws[1])
        named = _beside(found.having, found.named)
        loud = found.loud or _unlike(found.bare, found.having, named)
        return cls(places, found, found.having, named, (*begun.already, *(one.refined.field_px for one in named)), loud)

    @property
    def unsettled(self) -> bool:
        """Whether the effects may have misled the choices that were made without them: one takes other names to mend what went wrong."""
        return bool(self.named) and (self.loud or len(self.named) == MOST)


def _looked_again(look: Look, families: Sequence[Family], known: Sequence[KnownEffect], draws: tuple[int, int]) -> Look:
    """About the point that is chosen without the effects, if that is another for what was named, and the data are likelier there."""
    try:
        again = beside(look.having, look.fields, (*families, *UNNAMED), known)
    except IllPosed:
        return look
    before, seen = look.having.design.observation, again.observation
    if not np.array_equal(seen.used, before.used):
        return look
    alike = seen.state.distortion.carried == before.state.distortion.carried
    if alike and not any(_moves_otherwise(one.refined, seen, look.having) for one in look.named):
        return look
    return max((look, Look.at(again, families, known, draws)), key=lambda one: one.having.likelihood)


def _moves_otherwise(one: Refined, seen: Observation, having: Ladder) -> bool:
    """Whether a law says something else of the maps about another point: by more than a part of their noise."""
    law = one.family.law(seen.scene, dict(one.values))
    if law is None:
        return True
    change = (law.field_px - one.field_px) @ one.amplitudes
    return float(np.sqrt(np.mean((change - change[0]) ** 2))) > LITTLE * having.design.whiten.sigma_px


def _beside(having: Ladder, named: Sequence[Named]) -> tuple[Named, ...]:
    """With amplitudes refitted beside each other; what was named itself is nobody's rival."""
    taken = {one.refined.family for one in named}
    both = zip(named, together(having, [one.refined for one in named]), strict=True)
    return tuple(replace(one, refined=refit, rivals=tuple(o for o in one.rivals if o.family not in taken)) for one, refit in both)


def _unlike(bare: Ladder, having: Ladder, named: Sequence[Named]) -> bool:
    """Whether something without a name is likelier than all names from some round on, or another course than that of their laws."""
    gained = np.cumsum([one.gain for one in reversed(named)])[::-1]
    if any(one.unnamed > total + ODDS for one, total in zip(named, gained, strict=True)):
        return True
    return likelier_course(having, bare.design, [one.refined for one in named]) > LOUD


def _told(heard: Sequence[Weighed]) -> tuple[tuple[str, float], ...]:
    return tuple((one.family.name, one.log_factor) for one in heard)


def _overlaps(bare: Ladder, named: Refined, heard: Sequence[Weighed]) -> tuple[tuple[str, float], ...]:
    """What other names, each as it is likeliest here, could take over of an effect; the most first."""
    scene, field = bare.design.observation.scene, named.field_px @ named.amplitudes
    found = []
    for one in heard:
        law = None if one.family is named.family or one.family in NAMELESS else one.family.law(scene, one.values[one.best[0]])
        if law is not None:
            found.append((one.family.name, overlap(bare, field, law.field_px)))
    return tuple(sorted(found, key=lambda item: -item[1]))


def _verdict(
    named: Sequence[Named], loud: bool, gap: Gap | None, places: tuple[Disagreement, ...], bare: Ladder, shares: Sequence[float]
) -> Diagnosis:
    effects = tuple(_found(one, share) for one, share in zip(named, shares, strict=True))
    noise_px = bare.design.whiten.sigma_px
    unsure = next((one for one in named if one.rivals or len(one.names) > 1), None)
    if not named:
        outcome = Outcome.UNKNOWN if loud else Outcome.NONE
    elif loud:  # what was named explains a part at best
        outcome = Outcome.UNKNOWN
    elif gap is not None and not _useful(gap, sum(one.gain for one in named)):
        outcome = Outcome.REJECTED
    else:
        outcome = Outcome.AMBIGUOUS if unsure else Outcome.IDENTIFIED
    if outcome is Outcome.AMBIGUOUS and unsure is not None:
        among = (unsure.refined.family, *(one.family for one in unsure.rivals))
        decides = next((one.decides for one in among if one.decides), "more pairs")
        names = (*unsure.names, *(one.family.name for one in unsure.rivals))
        return Diagnosis(outcome, effects, names, _group(among), Experiment(names, decides), gap, places, noise_px)
    return Diagnosis(outcome, effects, (), _group([one.refined.family for one in named]), None, gap, places, noise_px)


def _found(one: Named, share: float) -> FoundEffect:
    family, refined = one.refined.family, one.refined
    return FoundEffect(
        one.names[0],
        refined.parameters,
        refined.peak_px,
        one.gain,
        one.p_value,
        family.strain or share > HARMLESS,
        KnownEffect(family.name, refined.values, refined.found.size_px),
        tuple(refined.amplitudes.tolist()),
        tuple(tuple(row) for row in refined.covariance.tolist()),
        share,
    )


def _group(families: Sequence[Family]) -> str | None:
    return next((one.group for one in families if one.group), None)


def _useful(gap: Gap, log_factor: float) -> bool:
    """With what held-out pairs say against them effects would still be loud, and nothing says that most of their gap stays open.

    At twice the least effect that can be detected a real one gains 1.5 +- 1 standard errors on held-out pairs or, where they leave little
    of it to be seen, nothing: creep with a logarithm of the Bayes factor of 43 was rejected for a loss of 1.2.
    """
    return log_factor + min(gap.log_odds, 0.0) > LOUD and gap.closure_interval[1] > HALF
