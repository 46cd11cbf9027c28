"""Entities of an RO-Crate: files, persons, programs, instrument, specimen, licence, and what was done."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any
from urllib.parse import quote

from semlive.report.export.archive.deposit import NO_LICENCE, Deposit, Person
from semlive.report.export.archive.nexus_microscope import frame_infos, vendor_name
from semlive.report.export.archive.provenance import ExportProvenance, HashedFile
from semlive.report.export.fields import RunMetadata, constants

METADATA_FILE = "ro-crate-metadata.json"
FIELDS_FILE = "fields.nxs"
_CRATE = "https://w3id.org/ro/crate/1.1"
_PROCESS = "https://w3id.org/ro/wfrun/process/0.5"
_NXEM = "https://fairmat-nfdi.github.io/nexus_definitions/classes/applications/NXem.html"
_KINDS: Mapping[str, tuple[object, str]] = {
    ".nxs": (["application/x-hdf5", {"@id": _NXEM}], "Corrected displacement and strain with uncertainties, drift, distortion, load"),
    ".mcap": ("application/x-mcap", "Log of the run: images, load, settings, disparity maps and results"),
    ".json": ("application/json", ""),
}
_DESCRIPTIONS = {
    "result.json": "Result of the analysis",
    "settings.json": "Settings of the analysis",
    "configuration.json": "Configuration of the run",
}

Entity = dict[str, Any]


def crate(metadata: RunMetadata, files: Sequence[HashedFile]) -> Entity:
    """Return the content of ``ro-crate-metadata.json``.

    Args:
        metadata: the run, with its provenance.
        files: files of the crate with names relative to it.
    """
    provenance = metadata.provenance
    assert provenance is not None  # checked by the writer
    deposit = provenance.deposit
    people = [_person(person, number) for number, person in enumerate(deposit.people, 1)]
    organisations = _affiliations(deposit.people)
    licence = _licence(deposit.licence)
    measured = list(_measured(metadata))
    subjects = [_sample(metadata, deposit), _microscope(metadata, provenance)]
    programs = list(_programs(provenance))
    actions = _actions(metadata, files, people, programs)
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": deposit.title or metadata.name,
        "description": deposit.description
        or f"In-situ loading experiment in a scanning electron microscope: run {metadata.name}, {len(metadata.result.decisions)} pairs.",
        "datePublished": deposit.date,
        "license": _reference(licence),
        "conformsTo": {"@id": _PROCESS},
        "hasPart": [{"@id": _path(file.name)} for file in files],
        "mentions": _references(actions),
        "about": _references(subjects),
        **({"author": _references(people)} if people else {}),
        **({"publisher": _reference(organisations[0])} if organisations else {}),
        **({"keywords": ", ".join(deposit.keywords)} if deposit.keywords else {}),
        **({"variableMeasured": _references(measured)} if measured else {}),
    }
    descriptor = {"@id": METADATA_FILE, "@type": "CreativeWork", "conformsTo": {"@id": _CRATE}, "about": {"@id": "./"}}
    return {
        "@context": [f"{_CRATE}/context", {"sha256": "http://schema.org/sha256"}],
        "@graph": [
            descriptor,
            root,
            *(_file(file) for file in files),
            licence,
            *people,
            *organisations,
            *subjects,
            *actions,
            *programs,
            *measured,
            {"@id": _PROCESS, "@type": "CreativeWork", "name": "Process Run Crate", "version": "0.5"},
            {"@id": _NXEM, "@type": "WebSite", "name": "NeXus application definition NXem"},
        ],
    }


def _file(file: HashedFile) -> Entity:
    encoding, description = _KINDS.get(
        file.name[file.name.rfind(".") :], ("application/octet-stream", "Part of the log that was not finished")
    )
    return {
        "@id": _path(file.name),
        "@type": "File",
        "name": file.name,
        "description": _DESCRIPTIONS.get(file.name, description),
        "encodingFormat": encoding,
        "contentSize": str(file.size),
        "sha256": file.sha256,
    }


def _actions(
    metadata: RunMetadata, files: Sequence[HashedFile], people: Sequence[Entity], programs: Sequence[Entity]
) -> tuple[Entity, Entity]:
    """Return the recording of the run, and its analysis; `programs` begins with the programs of analysis and recording."""
    analysing, recording_program = (_reference(program) for program in programs[:2])
    infos = frame_infos(metadata).values()
    entities = [(file.name.startswith("log/"), {"@id": _path(file.name)}) for file in files]
    log = _references([entity for is_log, entity in entities if is_log])
    results = _references([entity for is_log, entity in entities if not is_log])
    agent = {"agent": _reference(people[0])} if people else {}
    recording = {
        "@id": "#recording",
        "@type": "CreateAction",
        "name": f"Recording of the run {metadata.name}",
        "description": "Loading of the specimen in the microscope, with pairs of images at each load.",
        "startTime": _seconds(min(info.start_time_ns.value for info in infos)),
        "endTime": _seconds(max(info.end_time_ns for info in infos)),
        "instrument": recording_program,
        "result": log,
        **agent,
    }
    analysis = {
        "@id": "#analysis",
        "@type": "CreateAction",
        "name": "Analysis of the log",
        "description": f"Drift, distortion, displacement and strain by the method {metadata.result_json['method']}.",
        "endTime": datetime.now(UTC).isoformat(timespec="seconds"),
        "instrument": analysing,
        "object": log,
        "result": results,
        **agent,
    }
    return recording, analysis


def _programs(provenance: ExportProvenance) -> Iterable[Entity]:
    recorded = provenance.versions.get("semlive", "unknown")
    address = provenance.deposit.program_address
    for key, version in (("semlive", provenance.semlive), ("semlive-recording", recorded)):
        yield {
            "@id": f"{address or ''}#{key}",
            "@type": "SoftwareApplication",
            "name": "semlive",
            "description": "Live drift- and distortion-corrected strain measurement inside a scanning electron microscope.",
            "version": version,
            "license": {"@id": "https://spdx.org/licenses/BSD-3-Clause"},
            **({"url": address} if address else {}),
        }
    yield {"@id": "https://spdx.org/licenses/BSD-3-Clause", "@type": "CreativeWork", "name": "BSD 3-Clause License"}


def _microscope(metadata: RunMetadata, provenance: ExportProvenance) -> Entity:
    described, infos = provenance.deposit.instrument, frame_infos(metadata)
    model = described.model or provenance.instrument or "unknown"
    maker = vendor_name(infos[min(infos)], provenance)
    entity = {
        "@id": "#microscope",
        "@type": "IndividualProduct",
        "name": described.name or f"scanning electron microscope, {maker} {model}",
        "description": "Scanning electron microscope" + ("" if described.location is None else f" at {described.location}"),
        "model": model,
        "manufacturer": maker,
        "serialNumber": described.serial_number,
    }
    return {key: value for key, value in entity.items() if value is not None}


def _sample(metadata: RunMetadata, deposit: Deposit) -> Entity:
    sample = deposit.sample
    elements = None if sample.atom_types is None else f"Elements: {sample.atom_types}"
    entity = {
        "@id": "#sample",
        "@type": "Thing",
        "name": sample.name or metadata.settings["specimen.name"] or "specimen",
        "description": sample.description or elements or "Specimen of the run",
        "identifier": sample.identifier,
    }
    return {key: value for key, value in entity.items() if value is not None}


def _measured(metadata: RunMetadata) -> Iterable[Entity]:
    """Return the elastic constants with their standard uncertainties."""
    present = constants(metadata)
    for key, name, unit in (("youngs_modulus_gpa", "Young's modulus", "GPa"), ("poissons_ratio", "Poisson's ratio", "1")):
        if key in present:
            yield {
                "@id": f"#{key}",
                "@type": "PropertyValue",
                "name": name,
                "value": present[key],
                "unitText": unit,
                "description": f"standard uncertainty {present[key + '_sigma']:.3g}",
            }


def _person(person: Person, number: int) -> Entity:
    entity: Entity = {
        "@id": f"#person{number}" if person.orcid is None else f"https://orcid.org/{person.orcid}",
        "@type": "Person",
        "name": person.name,
        "email": person.email,
        "affiliation": None if person.affiliation is None else {"@id": _organisation_id(person.affiliation, person.affiliation_address)},
        "description": person.role,
    }
    return {key: value for key, value in entity.items() if value is not None}


def _affiliations(people: Iterable[Person]) -> list[Entity]:
    named = dict.fromkeys((person.affiliation, person.affiliation_address) for person in people if person.affiliation is not None)
    return [
        {"@id": _organisation_id(name, address), "@type": "Organization", "name": name, **({"url": address} if address else {})}
        for name, address in named
    ]


def _organisation_id(name: str, address: str | None) -> str:
    return address or f"#organisation-{quote(name, safe='')}"


def _licence(licence: str | None) -> Entity:
    if licence is None:
        return {"@id": "#licence-not-chosen", "@type": "CreativeWork", "name": "No licence chosen", "description": NO_LICENCE}
    key = licence if "://" in licence else f"https://spdx.org/licenses/{quote(licence)}"
    return {"@id": key, "@type": "CreativeWork", "name": licence, "description": f"Licence of these data: {licence}"}


def _reference(entity: Entity) -> Entity:
    return {"@id": entity["@id"]}


def _references(entities: Sequence[Entity]) -> Entity | list[Entity]:
    """Return references to entities; one alone is no list, as RO-Crate recommends."""
    found = [_reference(entity) for entity in entities]
    return found[0] if len(found) == 1 else found


def _seconds(time_ns: int) -> str:
    """Return an instant as ISO 8601 in whole seconds, as Process Run Crate recommends."""
    return datetime.fromtimestamp(time_ns // 10**9, UTC).isoformat()


def _path(name: str) -> str:
    return quote(name)
