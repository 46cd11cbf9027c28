"""Scenarios: the true parameters of a simulated experiment, read from YAML."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, InstanceOf, TypeAdapter, ValidationError

from semlive.errors import BadConfig
from semlive.inputs.files import read_regular
from semlive.inputs.yaml_text import MOST_BYTES, read_yaml
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.distortion import Distortion, named
from semlive_simulators.effects.drift import Drift
from semlive_simulators.effects.library import build_effects
from semlive_simulators.exporters.settings import Export
from semlive_simulators.load_frame.dynamics import LoadFrameParameters
from semlive_simulators.load_frame.fault_schedule import PlannedFault
from semlive_simulators.load_frame.strain_gage import StrainGage
from semlive_simulators.microscope.column import Column, Detector, Scan, build_column
from semlive_simulators.microscope.patterns import Pattern
from semlive_simulators.specimen.specimen import Specimen
from semlive_simulators.specimen.stage import BEAM_SHIFT, Actuator, StageParameters

FOLDER = Path(__file__).parent / "scenarios"


class BadScenario(Exception):
    """A scenario is missing or not valid; the message states the problem, its place and the remedy."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A simulated experiment.

    Attributes:
        name: name of the scenario.
        seed: seed of all random numbers except those of the speckle pattern.
        first_scan_s: start of the first scan, seconds since the run began.
        scan: the raster.
        speckle: the speckle pattern.
        specimen: the specimen.
        detector: noise and grey levels; its seed is set from `seed`.
        drift: true drift.
        distortion: true distortion.
        load_frame: the load frame.
        stage: the stage.
        export: settings of the exported files.
        experiment: a part of the configuration of the daemon, passed on without changes.
        strain_gage: strain gage on the specimen.
        beam_shift: beam shift of the column.
        shifts_by: actuator that a played experiment uses for its shifts.
        faults: faults of the load frame and its lines.
        effects: further effects by name (`semlive_simulators.effects.library`); none by default.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    name: str
    seed: int
    first_scan_s: float
    scan: Scan
    speckle: Pattern
    specimen: Specimen
    detector: Detector
    drift: Drift
    distortion: Annotated[Distortion, BeforeValidator(named)]
    load_frame: LoadFrameParameters
    stage: StageParameters
    export: Export
    experiment: dict[str, Any]
    strain_gage: StrainGage = field(default_factory=StrainGage)
    beam_shift: StageParameters = BEAM_SHIFT
    shifts_by: Actuator = Actuator.STAGE
    faults: tuple[PlannedFault, ...] = ()
    effects: Annotated[InstanceOf[EffectSet], BeforeValidator(build_effects)] = field(default_factory=EffectSet)

    def column(self) -> Column:
        """The column of the scenario."""
        return build_column(self.scan, self.detector, self.speckle, self.drift, self.distortion, self.effects)

    @property
    def row_start_s(self) -> tuple[float, ...]:
        """True start of each row, mean over its visits, s since the scan began; empty if no clock of the rows is exported."""
        return tuple(self.effects.timing(self.scan).row_start_s.mean(axis=0).tolist()) if self.export.row_clock else ()

    @property
    def gaged(self) -> bool:
        """Whether the experiment reads the strain gage."""
        machine = self.experiment.get("load_frame")
        return isinstance(machine, dict) and bool(machine.get("strain_gage", False))

    @property
    def frame_duration_s(self) -> float:
        """True duration of a frame, s, but not less than the nominal duration of the scan."""
        return max(self.scan.duration_s, self.effects.timing(self.scan).end_s)

    def stamp_ns(self, time_ns: int, run_start_ns: int) -> int:
        """Time of an instant on the clock of the microscope PC, UTC ns; `run_start_ns` is the start of the run."""
        since_start_s = (time_ns - run_start_ns) * 1e-9
        error_s = self.effects.readings().stamp_s(since_start_s) - since_start_s
        return time_ns + round(self.export.clock_offset_s * 1e9) + round(error_s * 1e9)


def load_scenario(name: str, seed: int | None = None) -> Scenario:
    """Read a scenario by its name, or from a YAML file by its path.

    A file may contain ``extends: NAME`` and only the differences; mappings are merged, all other values are replaced.

    Args:
        name: ``paper_x200``, or a path that ends in ``.yaml``.
        seed: replaces the seed of the scenario; None does not.

    Raises:
        BadScenario: if it does not exist or is not valid.
    """
    fields = _read(name)
    if seed is not None:
        fields["seed"] = seed
    if isinstance(fields.get("detector"), dict):
        fields["detector"] = {**fields["detector"], "seed": fields.get("seed", 0)}
    try:
        return TypeAdapter(Scenario).validate_python(fields)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise BadScenario(f"scenario {name}: {key}: {first['msg']}; correct it") from error


def names() -> list[str]:
    """Names of the bundled scenarios."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def _read(name: str, depth: int = 0) -> dict[str, Any]:
    path = Path(name) if name.endswith(".yaml") else FOLDER / f"{name}.yaml"
    try:
        fields = read_yaml(read_regular(path, MOST_BYTES), path.name).value
    except FileNotFoundError as error:
        raise BadScenario(f"scenario {name} does not exist; choose {', '.join(names())} or give a path ending in .yaml") from error
    except OSError as error:
        raise BadScenario(f"scenario {name} cannot be read ({error.strerror}); give a path ending in .yaml") from error
    except BadConfig as error:
        raise BadScenario(f"scenario {error}") from error
    if not isinstance(fields, dict):
        raise BadScenario(f"scenario {name} holds no keys; correct {path.name}")
    fields.setdefault("name", path.stem)
    base = fields.pop("extends", None)
    if base is None:
        return fields
    if depth > 4:
        raise BadScenario(f"scenario {name} extends too many scenarios; correct {path.name}")
    return _merged(_read(str(base), depth + 1), fields)


def _merged(base: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in change.items():
        old = merged.get(key)
        merged[key] = _merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged
