"""Correlation of the noise of imported maps over neighbouring points: given, in the maps, or estimated from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from semlive.formats.tables.disparity_grid import grid_of, map_on
from semlive.formats.tables.disparity_table import DisparityTable
from semlive.mechanics.correlation_length import correlation_of
from semlive.service.log.settings import ImportNoise

MIN_SUBSETS_PER_AXIS = 6  # of the field; a diagnosis needs 24 blocks as large as a subset


def noise_of(given_px: int | None, first: DisparityTable, within_pairs: Callable[[], Iterable[DisparityTable]]) -> ImportNoise:
    """Correlation of the noise of all maps of an import.

    Args:
        given_px: edge of the subset from the command line; None if not given.
        first: the first map.
        within_pairs: reads some maps within pairs; called only if they are needed.

    Raises:
        BadInput: a map is wrong.
    """
    if given_px is not None:
        return ImportNoise(subset_px=given_px, source="given")
    if first.subset_px:
        return ImportNoise(subset_px=first.subset_px, source="maps")
    grid = grid_of(first, 0)
    found = correlation_of([map_on(table, grid, 2 * number, 2 * number + 1) for number, table in enumerate(within_pairs())])
    if found is None:
        return ImportNoise(subset_px=0, source="assumed")
    largest_px = int(grid.step_px * min(grid.nx, grid.ny) / MIN_SUBSETS_PER_AXIS)
    return ImportNoise(
        subset_px=min(found.subset_px, max(largest_px, grid.step_px)),
        source="estimated",
        edge_px=found.edge_px,
        sigma_px=found.sigma_px,
        gaussian=found.gaussian,
        own_fraction=found.own_fraction,
        maps=found.maps,
    )


def noise_text(noise: ImportNoise, step_px: int) -> str:
    """One sentence about the correlation of the noise and its source."""
    source = {
        "given": "as given with --subset-px",
        "maps": "the value in the maps",
        "estimated": f"estimated from the noise of {noise.maps} maps within pairs",
        "assumed": "assumed, because the maps have too few points for an estimate; give --subset-px",
    }[noise.source]
    over = f"correlated over {noise.subset_px} px" if noise.subset_px > step_px else "independent"
    return f"noise of neighbouring points: {over}, {source}"
