"""Diagnosis of a log: its disparity maps, the joint estimate of them, and what is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from semlive import pipeline
from semlive.data.diagnosis import NO_MODEL, Diagnosis, Experiment, Foretold, FoundEffect, FoundParameter, Gap, KnownEffect
from semlive.diagnose.foretelling import foretold
from semlive.diagnose.gage_channel import gage_readings_of, with_gage
from semlive.diagnose.grey_channel import diagnose_grey
from semlive.diagnose.judge import diagnose
from semlive.diagnose.known import showing
from semlive.diagnose.load_channel import readings_of, with_clock, with_loads
from semlive.diagnose.moves import moves_of, with_moves
from semlive.diagnose.observation import HOLD_S, Observation, StepFacts, first_solution, observe, steps_of
from semlive.diagnose.propose import ranked
from semlive.diagnose.row_channel import diagnose_rows
from semlive.diagnose.verdict import with_grey, with_rows
from semlive.errors import BadLog, IllPosed
from semlive.model.grey_effects import of_grey
from semlive.model.move_effects import beside_maps
from semlive.model.row_effects import of_rows
from semlive.service.blas import one_blas_thread
from semlive.service.image_channels import ImageChannels, channels_of_log
from semlive.service.log_pairs import Words, first_run, log_settings, mapped_pairs


def diagnose_log(
    log: Path, seed: int = 0, watch: Callable[[str, int, int], None] | None = None, known: Sequence[KnownEffect] = ()
) -> Diagnosis:
    """What is missing from the model of a run, by the disparity maps in its log and, where it holds images, their rows and grey levels.

    Args:
        log: one file, or a run folder.
        seed: of the draws of the null.
        watch: told what is done, how much of it, of how much.
        known: effects that the model has already.

    Raises:
        BadInput: the log cannot be read, or its data are too few to name anything.
    """
    words = Words()
    seen, steps = _observed(log, words, watch)
    found = diagnose(seen, seed, known=showing(seen, [one for one in known if beside_maps(one.name) is None]))
    found = with_moves(replace(found, known=tuple(known)), moves_of(seen, steps))
    if found.experiment is not None:
        found = replace(found, experiment=ranked(found.experiment, foretold(seen, found, known)))
    settings = log_settings(log)
    readings = readings_of(seen, steps, settings.specimen.loading_axis)
    found = with_loads(found, readings)
    found = with_gage(found, gage_readings_of(readings, steps, settings.specimen.gage_factor_sigma))
    if words.sem_clock is not None:
        found = with_clock(found, words.sem_clock.offset_s - settings.scan.clock_offset_s, words.sem_clock.sigma_s)
    seen_beside = channels_of_log(log, watch)
    return _beside_grey(_beside_rows(found, seen_beside, seed), seen_beside)


def _beside_rows(found: Diagnosis, seen: ImageChannels, seed: int) -> Diagnosis:
    if not seen.rows:
        return replace(found, no_rows=seen.no_rows)
    try:
        rows = diagnose_rows(seen.rows, seed, [one for one in found.known if of_rows(one.name) is not None])
    except IllPosed as error:
        return replace(found, no_rows=str(error))
    return with_rows(found, rows)


def _beside_grey(found: Diagnosis, seen: ImageChannels) -> Diagnosis:
    if seen.grey is None:
        return replace(found, no_grey=seen.no_grey)
    try:
        grey = diagnose_grey(seen.grey, [one for one in found.known if of_grey(one.name) is not None])
    except IllPosed as error:
        return replace(found, no_grey=str(error))
    return with_grey(found, grey)


def experiments_after(
    log: Path, found: Diagnosis, watch: Callable[[str, int, int], None] | None = None, known: Sequence[KnownEffect] = ()
) -> tuple[Foretold, ...]:
    """What further experiments are expected to decide of a verdict, the most for a minute first; of one effect against nothing.

    Args:
        log: that was diagnosed.
        found: the verdict.
        watch: told what is done, how much of it, of how much.
        known: effects that the model had before.
    """
    if found.experiment is not None:
        return found.experiment.foretold
    return foretold(observed(log, watch), found, known) if found.effects else ()


def observed(log: Path, watch: Callable[[str, int, int], None] | None = None) -> Observation:
    """What a run's disparity maps show, estimated jointly without further effects.

    Raises:
        BadInput: the log cannot be read, or its data are too few to name anything.
    """
    return _observed(log, Words(), watch)[0]


def _observed(log: Path, words: Words, watch: Callable[[str, int, int], None] | None) -> tuple[Observation, tuple[StepFacts, ...]]:
    one_blas_thread()
    settings = log_settings(log)
    settings = replace(settings, estimate=replace(settings.estimate, method="joint"), model=NO_MODEL)
    begun = None
    for done, (decision, maps) in enumerate(mapped_pairs(log, words), start=1):
        begun = begun or pipeline.begin_from_maps(settings, decision.first, maps[0].grid)
        within = tuple(one for one in maps if one.reference != 0)
        begun = pipeline.absorb(begun, decision, (*within, *pipeline.seen_from_frame_0(decision.pair, maps)))
        if watch is not None:
            watch("pair", done, done)
    if begun is None:
        raise BadLog(f"{log}: holds no disparity maps; replay it from its images first.")
    steps = steps_of(begun.pairs, _hold_s(log))
    solution, other = first_solution(begun.estimator)
    return observe(solution, steps, other), steps


def _hold_s(log: Path) -> float:
    """The hold before the pairs of a log's run: as configured, or the paper's where nothing tells."""
    protocol = first_run(log).config.get("protocol")
    hold = protocol.get("hold_s") if isinstance(protocol, dict) else None
    return float(hold) if isinstance(hold, int | float) else HOLD_S


def diagnosis_json(found: Diagnosis) -> dict[str, Any]:
    """The verdict as other programs read it (`semlive diagnose LOG --json`); only ever extended."""
    return {
        "outcome": found.outcome.value,
        "effects": [effect_json(one) for one in found.effects],
        "ambiguous": list(found.ambiguous),
        "group": found.group,
        "experiment": None if found.experiment is None else _experiment_json(found.experiment),
        "gap": None if found.gap is None else gap_json(found.gap),
        "where": [asdict(one) for one in found.where],
        "noise_px": found.noise_px,
        "evidence": dict(found.evidence),
        "overlap": dict(found.overlap),
        "coarse": list(found.coarse),
        "rows": _rows_json(found),
        "grey": _grey_json(found),
    }


def _experiment_json(found: Experiment) -> dict[str, Any]:
    return {"between": list(found.between), "about": found.about, "foretold": [foretold_json(one) for one in found.foretold]}


def foretold_json(one: Foretold) -> dict[str, Any]:
    """What an experiment is expected to decide, as other programs read it."""
    return {**asdict(one), "log_odds_per_minute": one.per_minute}


def _rows_json(found: Diagnosis) -> dict[str, Any]:
    rows = found.rows
    if rows is None:
        return {"looked_at": False, "why_not": found.no_rows}
    return {
        "looked_at": True,
        "outcome": rows.outcome.value,
        "pairs": rows.pairs,
        "rows": rows.rows,
        "noise_px": rows.noise_px,
        "gap": None if rows.gap is None else gap_json(rows.gap),
    }


def _grey_json(found: Diagnosis) -> dict[str, Any]:
    grey = found.grey
    if grey is None:
        return {"looked_at": False, "why_not": found.no_grey}
    return {
        "looked_at": True,
        "outcome": grey.outcome.value,
        "frames": grey.frames,
        "blocks": grey.blocks,
        "noise": parameters_json(grey.noise),
        "mean_levels": grey.mean_levels,
        "contrast_levels": grey.contrast_levels,
        "clipped": grey.clipped,
        "left": grey.left,
    }


def gap_json(gap: Gap) -> dict[str, Any]:
    """A gap as other programs read it."""
    return {
        "before_px": gap.before_px,
        "after_px": gap.after_px,
        "floor_px": gap.floor_px,
        "closure": gap.closure,
        "closure_interval": list(gap.closure_interval),
    }


def effect_json(one: FoundEffect) -> dict[str, Any]:
    """An effect as other programs read it."""
    return {
        "name": one.name,
        "parameters": parameters_json(one.parameters),
        "peak_px": one.peak_px,
        "log_bayes_factor": one.log_bayes_factor,
        "p_value": one.p_value,
        "looks_like_strain": one.strain,
        "strain_eaten": one.strain_eaten,
    }


def parameters_json(parameters: Sequence[FoundParameter]) -> dict[str, Any]:
    """Parameters by name."""
    return {one.name: {"value": one.value, "sigma": one.sigma, "unit": one.unit} for one in parameters}
