"""Description of a deposit: what a log does not contain and a repository asks for, from a YAML file that the user writes."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, AwareDatetime, Field, ValidationError

from semlive.errors import BadConfig
from semlive.inputs.files import read_regular
from semlive.inputs.yaml_text import MOST_BYTES, read_yaml
from semlive.service.config.sections import Section

UNKNOWN = "unknown"
"""Value of a text that a format requires and that neither log nor description contains."""
NO_LICENCE = "The owner of these data has not chosen a licence yet: give `licence` in the file of --describe."

Text = Annotated[str, AfterValidator(str.strip), Field(min_length=1)]
Address = Annotated[str, Field(pattern=r"^https?://\S+$")]
Orcid = Annotated[str, Field(pattern=r"^\d{4}-\d{4}-\d{4}-\d{3}[\dX]$")]


class Person(Section):
    """A person.

    Attributes:
        name: full name.
        orcid: identifier as in ``0000-0002-1825-0097``.
        affiliation: institution.
        affiliation_address: web address of the institution, as in ``https://ror.org/...``.
        email: address.
        role: task in the experiment.
    """

    name: Text
    orcid: Orcid | None = None
    affiliation: Text | None = None
    affiliation_address: Address | None = None
    email: Text | None = None
    role: Text | None = None


class Instrument(Section):
    """The microscope; what is not given is read from the images, or unknown.

    Attributes:
        name: name in the laboratory.
        location: institution and place.
        vendor: maker.
        model: type.
        serial_number: serial number.
        emitter_type: electron source, as in ``schottky`` or ``thermionic``.
    """

    name: Text | None = None
    location: Text | None = None
    vendor: Text | None = None
    model: Text | None = None
    serial_number: Text | None = None
    emitter_type: Text | None = None


class Sample(Section):
    """The specimen.

    Attributes:
        name: by default that of the configuration.
        identifier: identifier in the laboratory or of a registry.
        identifier_type: kind of identifier, as in ``DOI`` or ``IGSN``.
        atom_types: chemical elements, separated by commas.
        preparation_date: end of the preparation of the surface, with time zone.
        physical_form: form of the specimen.
        description: free text.
    """

    name: Text | None = None
    identifier: Text | None = None
    identifier_type: Text = "local"
    atom_types: Text | None = None
    preparation_date: AwareDatetime | None = None
    physical_form: Literal["bulk", "foil", "thin_film", "powder"] | None = None
    description: Text | None = None


class Deposit(Section):
    """Description of a deposit.

    Attributes:
        title: title of the data; by default the name of the run.
        description: abstract.
        licence: address of the licence, or its SPDX identifier as in ``CC-BY-4.0``.
        keywords: keywords.
        published: date of the publication; by default today.
        program_address: web address from which semlive was obtained, for example of its repository.
        people: persons; the first is the author.
        instrument: the microscope.
        sample: the specimen.
    """

    title: Text | None = None
    description: Text | None = None
    licence: Text | None = None
    keywords: tuple[Text, ...] = ()
    published: Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\d$")] | None = None
    program_address: Address | None = None
    people: tuple[Person, ...] = ()
    instrument: Instrument = Instrument()
    sample: Sample = Sample()

    @property
    def missing(self) -> tuple[str, ...]:
        """Keys without a value that NeXus or a repository requires."""
        given = {
            "licence": self.licence,
            "people": self.people,
            "instrument.emitter_type": self.instrument.emitter_type,
            "sample.atom_types": self.sample.atom_types,
            "sample.preparation_date": self.sample.preparation_date,
        }
        return tuple(key for key, value in given.items() if not value)

    @property
    def invalid_without(self) -> tuple[str, ...]:
        """Keys without a value without which a NeXus file is not valid NXem."""
        return () if self.sample.preparation_date else ("sample.preparation_date",)

    @property
    def date(self) -> str:
        """Date of the publication as ISO 8601."""
        return self.published or datetime.now().astimezone().date().isoformat()


def read_deposit(path: Path) -> Deposit:
    """Read the description of a deposit.

    Raises:
        BadConfig: the file cannot be read, is not YAML, or has an invalid key or value.
    """
    try:
        data = read_regular(path, MOST_BYTES)
    except OSError as error:
        raise BadConfig(f"{path}: cannot be read ({error.strerror or error}); give the path of a YAML file") from error
    text = read_yaml(data, str(path))
    try:
        return Deposit.model_validate(text.value)
    except ValidationError as error:
        first = error.errors()[0]
        key = (first.get("ctx") or {}).get("key")
        place = first["loc"] if key is None else (*first["loc"], str(key))
        line = text.line(place)
        where = f"{path}: " if line is None else f"{path}: line {line}: "
        raise BadConfig(f"{where}{'.'.join(map(str, place)) or 'sections'}: {first['msg'].rstrip('?')}; correct it") from error
