"""`semlive replay`: from disparity, with changed settings, in part, at a pace."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from semlive.errors import BadConfig
from semlive.service.analysis.result_json import json_differences, result_json
from semlive.service.config.overrides import parse_changes
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, Source, replay
from semlive.service.storage.map_store import MapStore

Semlive = Callable[..., tuple[int, str, str]]


SHAPE = {
    "pairs": int,
    "method": str,
    "window_points": int,
    "window_px": int,
    "vsg_px": int,
    "frames": list,
    "distortion": dict,
    "noise_floor_px": float,
    "elastic": dict,
    "strain_gage": type(None),
    "warnings": list,
}
FRAME = (
    "frame", "pair", "phase", "load_n", "gage_strain", "shift_px", "shift_sigma_px", "strain_mean", "strain_mean_sigma",
    "strain_mean_systematic", "strain_sd", "strain_gauge_sigma", "drift_start_px", "drift_end_px",
)  # fmt: skip


def test_json_has_the_agreed_shape(semlive: Semlive, imported: Path) -> None:
    code, out, err = semlive("replay", str(imported), "--json", "--method", "sutton2007")
    assert (code, err) == (0, "")
    reported = json.loads(out)
    assert {name: type(value) for name, value in reported.items()} == SHAPE
    assert reported["method"] == "sutton2007"
    for frame in reported["frames"]:
        assert tuple(frame) == FRAME
        assert set(frame["strain_mean"]) == set(frame["strain_mean_sigma"]) == set(frame["strain_sd"]) == {"exx", "eyy", "exy"}
        assert len(frame["shift_px"]) == len(frame["drift_end_px"]) == 2
    assert set(reported["distortion"]) == {"max_px", "rms_px"}
    assert set(reported["elastic"]) == {"youngs_modulus_gpa", "poissons_ratio"}
    assert set(reported["elastic"]["poissons_ratio"]) == {"value", "sigma"}


def test_a_replay_is_reproducible_for_every_storage_of_maps(imported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reported = []
    for in_memory in (2**30, 0):
        monkeypatch.setattr(MapStore.__init__, "__defaults__", (in_memory,))
        frames = []
        done = replay(ReplayRequest(imported), ReplayCallbacks(frame=frames.append))
        assert done.result.frames == ()
        assert len(frames) == 24
        reported.append(json.dumps(result_json(done.result, done.settings)))
    assert reported[0] == reported[1]


def test_only_the_first_pairs(imported: Path) -> None:
    done = replay(ReplayRequest(imported, until=6))
    assert [item.pair for item in done.result.decisions] == list(range(7))
    assert not done.unchanged


def test_changed_settings_are_set_next_to_the_logs_own(semlive: Semlive, short: Path) -> None:
    code, out, err = semlive("replay", str(short), "--set", "estimate.window=5")
    assert (code, err) == (0, "")
    assert "log's own settings and new result" in out
    assert any(line.split()[:4] == ["vsg_px", "400", "200", "-200"] for line in out.splitlines())
    before, after = (replay(ReplayRequest(short, changes=parse_changes(words))) for words in ([], ["estimate.window=5"]))
    assert json_differences(*(result_json(item.result, item.settings) for item in (before, after)))
    assert after.settings.estimate.window_points == 5


def test_at_a_given_pace_pairs_are_reported_as_they_come(short: Path) -> None:
    observed: list[tuple[int, float]] = []
    begin = time.monotonic()
    # A pair every 429.35 s of the log: 1,288 s from the first to the fourth, at 2,000 times life 0.64 s.
    replay(
        ReplayRequest(short, speed=2000.0),
        ReplayCallbacks(pair=lambda decision, _: observed.append((decision.pair, time.monotonic() - begin))),
    )
    assert [pair for pair, _ in observed] == list(range(4))
    assert observed[-1][1] - observed[0][1] > 0.63


def test_pairs_are_printed_at_a_pace(semlive: Semlive, short: Path) -> None:
    code, out, err = semlive("replay", str(short), "--speed", "1e6", "--until", "2")
    assert (code, err) == (0, "")
    assert [line.split()[1] for line in out.splitlines() if line.startswith("pair ")] == [str(item) for item in range(3)]


SETTINGS = {
    ("dic.subset=31",): ("dic.subset_px", 31),
    ("dic.roi=101,101,846,696",): ("dic.roi_px", (101, 101, 846, 696)),
    ("dic.roi_px=null",): ("dic.roi_px", None),
    ("estimate.strain.order=2",): ("estimate.strain.order", 2),
    ("estimate.method=sutton2007",): ("estimate.method", "sutton2007"),
    ("specimen.area=2.5",): ("specimen.area_mm2", 2.5),
    ("estimate.sutton_phases_apart=false",): ("estimate.sutton_phases_apart", False),
}


@pytest.mark.parametrize("words", SETTINGS)
def test_settings_by_name(words: tuple[str, ...]) -> None:
    (change,) = parse_changes(words)
    assert (change.key, change.value) == SETTINGS[words]


WRONG = {
    "dic.subest=31": "--set dic.subest=31: unknown key dic.subest; did you mean dic.subset_px?",
    "dic.subset": "--set dic.subset: has no value; write key=value",
    "dic.subset=large": "valid integer",
    "dic.subset=30": "subset_px must be odd and at least 5, not 30; correct it.",
    "estimate.strain.weights=flat": "correct the value of estimate.strain.weights",
    "dic.roi=1,2,3": "correct the value of dic.roi_px",
}


@pytest.mark.parametrize("word", WRONG)
def test_a_wrong_setting_gives_one_error_line(short: Path, word: str) -> None:
    with pytest.raises(BadConfig) as wrong:
        replay(ReplayRequest(short, changes=parse_changes([word]), source=Source.IMAGES))
    assert WRONG[word] in str(wrong.value)
    assert "\n" not in str(wrong.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--from-images", "--from-disparity"), "give only one of them"),
        (("--speed", "0"), "give a number above 0"),
        (("--model", "model.json"), "give a file that `semlive diagnose LOG -o FILE` wrote"),
        (("--set", "dic.subset=31"), "starts from disparity maps; give a log with images and --from-images."),
    ],
)
def test_options_that_do_not_fit_are_refused(semlive: Semlive, short: Path, options: tuple[str, ...], message: str) -> None:
    code, out, err = semlive("replay", str(short), *options)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert message in err
