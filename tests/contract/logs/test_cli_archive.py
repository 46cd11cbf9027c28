"""`semlive export --format nexus` and `ro-crate`: a run for a repository."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from rsciio.nexus import file_reader

sys.path.insert(0, str(Path(__file__).parent))

from nexus_rules import problems

from semlive.cli.app import run_app
from semlive.data.frame import ColumnSettings
from semlive.data.loading import LoadSeries
from semlive.data.scan import Provenance, Sourced
from semlive.errors import BadConfig
from semlive.report.export import read_deposit
from semlive.report.export.archive.deposit import NO_LICENCE, Deposit
from semlive.report.export.archive.nexus_writer import NexusWriter
from semlive.report.export.archive.provenance import HashedFile, export_provenance
from semlive.report.export.export import run_metadata
from semlive.service.replay.replay import ReplayRequest, replay

Semlive = Callable[..., tuple[int, str, str]]
DESCRIPTION = """\
title: Aluminium in tension
description: Seven load steps.
licence: CC-BY-4.0
keywords: [DIC, SEM]
published: "2026-11-26"
program_address: https://example.org/semlive
people:
  - {name: Ada Lovelace, orcid: 0000-0002-1825-0097, affiliation: Example University,
     affiliation_address: "https://example.org", role: operator}
  - {name: Charles Babbage}
instrument: {name: SEM 2, location: Example University, vendor: FEI, model: Quanta 600, serial_number: D9033, emitter_type: schottky}
sample:
  name: al-2024-01
  identifier: al-2024-01
  atom_types: Al, Cu, Mg
  preparation_date: 2026-11-01T10:00:00+01:00
  physical_form: bulk
"""


@pytest.fixture(scope="module")
def description(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("described") / "deposit.yaml"
    path.write_text(DESCRIPTION, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def crate(imported: Path, description: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("archive") / "crate"
    with pytest.MonkeyPatch.context() as patch:
        command = ["semlive", "export", str(imported), "--format", "ro-crate", "-o", str(out), "--until", "5"]
        patch.setattr("sys.argv", [*command, "--describe", str(description)])
        assert run_app() == 0
    return out


@pytest.fixture(scope="module")
def graph(crate: Path) -> dict[str, dict[str, Any]]:
    content = json.loads((crate / "ro-crate-metadata.json").read_text(encoding="utf-8"))
    entities = content["@graph"]
    assert len({entity["@id"] for entity in entities}) == len(entities)
    return {entity["@id"]: entity for entity in entities}


@pytest.fixture(scope="module")
def summary(imported: Path) -> Any:
    return replay(ReplayRequest(imported, until=5))


@pytest.fixture(scope="module")
def loaded(summary: Any, imported: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fields of a log as a load frame and a microscope with images would have left them."""
    metadata = run_metadata(imported, summary)
    column = ColumnSettings(
        Sourced("ETD", Provenance.FILE), Sourced(2e4, Provenance.FILE), Sourced(0.01, Provenance.FILE), None, Sourced(90.0, Provenance.FILE)
    )
    infos = [dataclasses.replace(decision.first, column=column) for decision in summary.result.decisions]
    decisions = tuple(
        dataclasses.replace(decision, first=info, second=dataclasses.replace(decision.second, column=column))
        for decision, info in zip(summary.result.decisions, infos, strict=True)
    )
    provenance = export_provenance(imported, Deposit(), summary.settings.scan)
    provenance = dataclasses.replace(provenance, images={infos[0].export: HashedFile(None, "a.tif", 9, "0" * 64)})
    load = LoadSeries(np.array([10**9, 3 * 10**9]), np.array([1.0, 2.0]), np.array([0.0, 0.1]), None)
    result = dataclasses.replace(summary.result, decisions=decisions)
    out = tmp_path_factory.mktemp("loaded") / "loaded.nxs"
    writer = NexusWriter(out)
    writer.write_frame(summary.result.frames[0])
    writer.write_metadata(dataclasses.replace(metadata, result=result, load=load, provenance=provenance))
    writer.close(True)
    return out


def test_nexus_has_what_nxem_requires(crate: Path) -> None:
    with h5py.File(crate / "fields.nxs") as file:
        assert list(problems(file)) == []
        entry = file["entry"]
        assert entry["definition"].asstr()[()] == "NXem"
        assert len([name for name in entry["measurement"] if name.startswith("event_")]) == 12
        assert entry["user1/identifier_orcid"].asstr()[()] == "0000-0002-1825-0097"
        assert set(entry["user1"]) == {"name", "affiliation", "role", "identifier_orcid"}  # NXuser knows no other
        assert entry["sample1/atom_types"].asstr()[()] == "Al, Cu, Mg"
        assert entry["measurement/instrument/fabrication/model"].asstr()[()] == "Quanta 600"
        assert json.loads(entry["semlive/settings"].asstr()[()])["estimate.window_points"] == 9


def test_nexus_without_description_lacks_only_the_date_of_the_preparation(loaded: Path) -> None:
    with h5py.File(loaded) as file:
        assert list(problems(file)) == ["entry/sample1: preparation_date is missing"]
        assert file["entry/measurement/instrument/fabrication/model"].asstr()[()] == "unknown"


def test_a_missing_member_is_found(loaded: Path, tmp_path: Path) -> None:
    changed = tmp_path / "changed.nxs"
    changed.write_bytes(loaded.read_bytes())
    with h5py.File(changed, "a") as file:
        del file["entry/measurement/instrument/fabrication/vendor"]
        file["entry/roi1/u"].attrs["axes"] = ["frame"]
        file["entry"].create_group("invented").attrs["NX_class"] = "NXdata"
        assert set(problems(file)) >= {
            "entry/measurement/instrument/fabrication: vendor is missing",
            "/entry/roi1/u: 1 axes for 3 dimensions",
            "entry/invented: NXem has no such group",
        }


def test_nexus_stacks_are_the_fields_with_uncertainties(crate: Path, summary: Any) -> None:
    frame = summary.result.frames[11]
    with h5py.File(crate / "fields.nxs") as file:
        roi = file["entry/roi1"]
        moved, valid = frame.displacement, frame.displacement.valid
        for name, values in (("v/v", moved.v_px), ("v/v_errors", moved.sigma_v_px), ("u/u_errors", moved.sigma_u_px)):
            np.testing.assert_array_equal(roi[name][11], np.where(valid, values, np.nan))
        np.testing.assert_array_equal(roi["eyy/eyy"][11], np.where(frame.strain.valid, frame.strain.eyy, np.nan))
        assert roi["v/v_systematic"].shape == roi["v/v"].shape
        np.testing.assert_array_equal(roi["eyy/x"], summary.analysis.grid.x_px)
        assert roi["eyy"].attrs["signal"] == "eyy"
        assert list(roi["eyy"].attrs["axes"]) == ["frame", "y", "x"]
        assert roi["eyy/frame"][()].tolist() == list(range(12))
        np.testing.assert_array_equal(roi["drift/dx_errors"], summary.result.estimate.drift.sigma_px[:, 0])
        assert roi["series/phase"].asstr()[-1] == "tension"


def test_nexus_has_scan_times_with_their_source(loaded: Path, summary: Any) -> None:
    info = summary.result.decisions[0].first
    timing = info.timing
    with h5py.File(loaded) as file:
        event = file["entry/measurement/event_0"]
        scan, controller = event["scan"], event["instrument/ebeam_column/scan_controller"]
        assert scan["row_time"][()] == timing.row_time_s.value
        assert scan["row_time"].attrs["units"] == "s"
        assert scan["row_time"].attrs["source"] == timing.row_time_s.source
        assert scan["scan_rotation"][()] == 90.0
        assert controller["dwell_time"][()] == timing.dwell_time_s.value
        expected_s = max(timing.row_time_s.value - info.width_px * timing.dwell_time_s.value, 0.0)
        assert controller["flyback_time"][()] == pytest.approx(expected_s)
        assert event["instrument/ebeam_column/electron_source/voltage"][()] == 2e4
        assert event["image1/process/input/checksum"].asstr()[()] == "0" * 64


def test_nexus_has_the_load_as_sampled(loaded: Path) -> None:
    with h5py.File(loaded) as file:
        log = file["entry/measurement/instrument/sensor_force/value_log"]
        assert log["time"][()].tolist() == [0.0, 2.0]
        assert log["time"].attrs["start"] == "1970-01-01T00:00:01.000000+00:00"
        assert log["value"][()].tolist() == [1.0, 2.0]


def test_hyperspy_reads_the_nexus_file(crate: Path, summary: Any) -> None:
    (signal,) = file_reader(str(crate / "fields.nxs"), nxdata_only=True, dataset_path="/entry/roi1/eyy", skip_array_metadata=True)
    frame, y, x = signal["axes"]
    grid = summary.analysis.grid
    assert (x["name"], x["scale"], x["offset"], x["units"]) == ("x", grid.step_px, grid.x0_px, "pixel")
    assert (y["size"], frame["size"]) == (grid.ny, 12)
    assert np.nanmax(signal["data"][11]) == summary.result.frames[11].strain.eyy[summary.result.frames[11].strain.valid].max()


def test_crate_lists_its_files_with_checksums(crate: Path, graph: dict[str, dict[str, Any]]) -> None:
    listed = {part["@id"] for part in graph["./"]["hasPart"]}
    on_disk = {path.relative_to(crate).as_posix() for path in crate.rglob("*") if path.is_file()} - {"ro-crate-metadata.json"}
    assert listed == on_disk == {"fields.nxs", "result.json", "settings.json", "configuration.json", "log/tension.mcap"}
    for name in listed:
        data = (crate / name).read_bytes()
        assert graph[name]["sha256"] == hashlib.sha256(data).hexdigest()
        assert graph[name]["contentSize"] == str(len(data))
        assert graph[name]["@type"] == "File"


def test_crate_names_persons_programs_instrument_and_licence(graph: dict[str, dict[str, Any]]) -> None:
    root = graph["./"]
    assert (root["name"], root["datePublished"]) == ("Aluminium in tension", "2026-11-26")
    assert graph[root["license"]["@id"]]["name"] == "CC-BY-4.0"
    assert [graph[author["@id"]]["name"] for author in root["author"]] == ["Ada Lovelace", "Charles Babbage"]
    assert graph["#microscope"]["model"] == "Quanta 600"
    assert graph[graph["#analysis"]["instrument"]["@id"]]["version"]
    assert graph["#analysis"]["object"] == {"@id": "log/tension.mcap"}
    assert graph[root["publisher"]["@id"]]["name"] == "Example University"


def test_every_reference_of_the_crate_leads_to_an_entity(graph: dict[str, dict[str, Any]]) -> None:
    def references(value: Any) -> list[str]:
        if isinstance(value, dict):
            return [value["@id"]] if value.keys() == {"@id"} else [found for item in value.values() for found in references(item)]
        return [found for item in value for found in references(item)] if isinstance(value, list) else []

    found = references(list(graph.values()))
    assert len(found) > 20
    assert [name for name in found if name not in graph and name != "https://w3id.org/ro/crate/1.1"] == []


def test_crate_without_description_contains_no_licence(semlive: Semlive, short: Path, tmp_path: Path) -> None:
    code, printed, err = semlive("export", short, "--format", "ro-crate", "-o", tmp_path / "crate", "--until", "0", "--json")
    assert code == 0
    assert err == "warning: the NeXus file is not valid NXem without sample.preparation_date; add it to a file for --describe\n"
    assert json.loads(printed)["invalid_without"] == ["sample.preparation_date"]
    assert json.loads(printed)["missing"] == [
        "licence", "people", "instrument.emitter_type", "sample.atom_types", "sample.preparation_date"
    ]  # fmt: skip
    entities = {entity["@id"]: entity for entity in json.loads((tmp_path / "crate" / "ro-crate-metadata.json").read_text())["@graph"]}
    assert entities[entities["./"]["license"]["@id"]]["description"] == NO_LICENCE


def test_crate_has_what_its_profiles_recommend_of_programs_and_institutions(graph: dict[str, dict[str, Any]]) -> None:
    recommended = [entity for entity in graph.values() if entity["@type"] in ("SoftwareApplication", "Organization")]
    assert len(recommended) == 3
    for entity in recommended:
        assert entity["@id"].startswith("https://example.org")
        assert entity["url"].startswith("https://example.org")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("people: [{name: A, affiliation: B, affiliation_address: here}]", "line 1: people.0.affiliation_address"),
        ("licens: MIT", "line 1: licens: did you mean licence; correct it"),
        ("people:\n  - {name: A, orcid: 12}", "line 2: people.0.orcid"),
        ("sample: {preparation_date: 2026-11-01T10:00:00}", "line 1: sample.preparation_date"),
        ("- a", r"sections: .*; correct it"),
    ],
)
def test_a_wrong_description_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "deposit.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadConfig, match=message):
        read_deposit(path)


def test_a_description_is_only_for_archives(semlive: Semlive, short: Path, description: Path, tmp_path: Path) -> None:
    code, out, err = semlive("export", short, "--format", "csv", "-o", tmp_path / "out", "--describe", description)
    assert (code, out) == (2, "")
    assert "--format nexus and ro-crate" in err
