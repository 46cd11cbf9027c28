"""`semlive experiment row-start`: a table of profiles becomes a law and the next experiment."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

Semlive = Callable[..., tuple[int, str, str]]
SETTINGS = ((4.0, 4e-7), (4.0, 1.6e-6), (8.0, 4e-7), (8.0, 1.6e-6))


def write(path: Path, settings: Sequence[tuple[float, float]]) -> Path:
    """22 nm over 1000 nm on the specimen."""
    rng, lines = np.random.default_rng(4), ["pixel_nm,pixel_s,distance_px,shift_px,sigma_px"]
    for pixel_nm, pixel_s in settings:
        for distance in range(2, 1000, 10):
            shift = 22.0 / pixel_nm * np.exp(-distance * pixel_nm / 1000.0) + rng.normal(0.0, 0.02)
            lines.append(f"{pixel_nm},{pixel_s},{distance},{shift:.5f},0.02")
    path.write_text("\n".join([*lines, ""]))
    return path


def test_settling_in_position_is_found_in_four_settings(semlive: Semlive, tmp_path: Path) -> None:
    code, out, err = semlive("experiment", "row-start", str(write(tmp_path / "four.csv", SETTINGS)), "--json")
    assert (code, err) == (0, "")
    printed = json.loads(out)
    assert (printed["outcome"], printed["laws"], printed["foretold"]) == ("IDENTIFIED", ["row_start_settling_in_position"], [])
    assert printed["constants"] == {"values": [pytest.approx(1000.0, rel=0.05)], "unit": "nm"}


def test_one_setting_ends_with_a_proposal(semlive: Semlive, tmp_path: Path) -> None:
    code, out, _ = semlive("experiment", "row-start", str(write(tmp_path / "one.csv", SETTINGS[:1])))
    assert code == 0
    assert out.startswith("AMBIGUOUS")
    assert "to decide: pixels of" in out


def test_a_missing_column_is_named(semlive: Semlive, tmp_path: Path) -> None:
    table = tmp_path / "wrong.csv"
    table.write_text("pixel_nm,pixel_s,distance_px,shift_px\n4,1e-6,1,0.1\n")
    code, _, err = semlive("experiment", "row-start", str(table))
    assert code == 2
    assert "column sigma_px is missing" in " ".join(err.split())
