"""docs/reference/cli.md and docs/reference/configuration.md, compared with the commands and the texts of the configuration.

Run ``python tests/golden/test_reference_pages.py`` to write them again after a deliberate change.
"""

from __future__ import annotations

import ast
import dataclasses
import enum
import inspect
import re
import sys
import textwrap
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from semlive.cli.app import COMMANDS
from semlive.cli.lazy import load
from semlive.data.experiment import Limits
from semlive.data.settings import DicSettings, EstimateSettings, ScanProfile, ScanSpeed, SpecimenSettings, StrainSettings
from semlive.service.config import sections
from semlive.service.config.checks import CONFIRMABLE
from semlive.service.config.model_section import ModelSection
from semlive_drivers.composite_config import AssembledSettings
from semlive_drivers.composite_load_frame import FrameSettings
from semlive_drivers.load_approach import ApproachSettings
from semlive_drivers.load_file.part import Column, CsvSettings
from semlive_drivers.microscope.autoscript import AutoScriptSettings
from semlive_drivers.microscope.sharksem.trigger import SharkSemSettings
from semlive_drivers.microscope.smartsem import SmartSemSettings
from semlive_drivers.modbus.settings import ModbusSettings, PartSettings, StageSettings
from semlive_drivers.operator.load_frame import OperatorFrameSettings
from semlive_drivers.operator.stage import OperatorSettings
from semlive_drivers.operator.trigger import OperatorTriggerSettings
from semlive_drivers.settings import SerialLine
from semlive_drivers.text.part import TextSettings

DOCS = Path(__file__).resolve().parents[2] / "docs" / "reference"
SECTIONS: tuple[tuple[str, type], ...] = (
    ("run", sections.RunSection),
    ("sem", sections.SemSection),
    ("sem.profile", ScanProfile),
    ("sem.scan_profiles", ScanSpeed),
    ("load_frame, stage, sem.trigger", sections.DriverSection),
    ("specimen", SpecimenSettings),
    ("alerts", sections.AlertsSection),
    ("protocol", sections.ProtocolSection),
    ("protocol.warm_up", sections.WarmUpSection),
    ("protocol.adaptive_hold", sections.AdaptiveHoldSection),
    ("limits", Limits),
    ("dic", DicSettings),
    ("estimate", EstimateSettings),
    ("estimate.strain", StrainSettings),
    ("model", ModelSection),
)
DRIVERS: tuple[tuple[str, type], ...] = (
    ("Load frame `modbus`, and each part `modbus` of an assembled one", PartSettings),
    ("Load frame `ascii`, and each part `ascii`", TextSettings),
    ("Load frame `assembled`", AssembledSettings),
    ("Load frame `operator`", OperatorFrameSettings),
    ("Further settings of each of these load frames", FrameSettings),
    ("`approach` of a load frame", ApproachSettings),
    ("Part `csv`, and `load_file` of the load frame `operator`", CsvSettings),
    ("`force`, `extension` and `gage` of such a file", Column),
    ("`serial` of `modbus` and `ascii`; the device map gives the other values", SerialLine),
    ("Stage `modbus`", StageSettings),
    ("Stage `operator`", OperatorSettings),
    ("Trigger `modbus`", ModbusSettings),
    ("Trigger `operator`", OperatorTriggerSettings),
    ("Trigger `sharksem`", SharkSemSettings),
    ("Trigger `smartsem`", SmartSemSettings),
    ("Trigger `autoscript`", AutoScriptSettings),
)
ELSEWHERE = {
    "host": "Address of the device on the network.",
    "port": "TCP port.",
    "SerialLine.port": "Path or name of the port: /dev/ttyUSB0, COM3.",
    "serial": "Serial line.",
    "unit": "Modbus unit (slave) number.",
    "Column.unit": "Unit of the numbers: N, kN, mm, um, ustrain, ...",
    "speed_max_mm_s": "Maximum speed of the drive.",
    "kind": "Specimen or beam, whichever the stage moves.",
    "baud": "Baud rate, bits per second.",
    "parity": "Parity of the line.",
    "stop_bits": "Stop bits of the line.",
    "silence_s": "Idle time before each request.",
    "slowest_s": "Longest time after which a late reply can still arrive.",
    "echo": "The line returns every byte that is sent on it (two wires).",
    "delimiter": "Character between columns; without it, tab, semicolon, comma or blanks are detected.",
    "decimal_comma": "Numbers have a decimal comma instead of a point.",
    "encoding": "Encoding of the text.",
    "force": "Column of the load.",
    "extension": "Column of the crosshead extension.",
    "gage": "Column of a strain gage.",
    "hold_s": "Hold between the end of settling and the first frame of the pair.",
    "settle_s": "Time for which load and stage must stay within tolerance before the hold.",
    "load_tolerance_n": "Allowed distance of the load from its target.",
    "load_tolerance_fraction": "Allowed distance as a fraction of the target; the larger of the two tolerances applies.",
    "stage_tolerance_um": "Allowed distance of the stage reading from its target.",
    "motion_timeout_s": "Time after which a motion that has not settled is a fault.",
    "frame_timeout_s": "Time of imaging without an acceptable frame that is a fault.",
    "ramp_rate_n_s": "Rate of load changes.",
    "calibration_shifts_px": "Positions (x, y) of the unloaded pairs for the distortion, in both directions.",
    "translation_shifts_px": "Positions (x, y) of the unloaded pairs that test the correction of the distortion.",
    "loads_n": "Loads at which pairs are taken, tension positive.",
    "name": "Name of the run and of its log.",
    "effects": "Name and `law` (basis field: `family`, `values`, `size_px`) of each effect.",
    "ModelSection.run": "`width_px`, `height_px` and `pixel_size_um` of the run from which the effects were estimated.",
    "max_hold_s": "Maximum duration of a hold.",
    "driver": "Name of an installed driver: [drivers](drivers.md).",
    "settings": "Settings of the driver: [drivers](drivers.md).",
    "folder": "Folder of the auto-save of the microscope.",
    "poll_s": "Interval at which the folder is checked, s of wall time.",
    "trigger": "Device that triggers the scan of a frame; without it, every frame counts whose scan began after the hold.",
    "profile": "Values that files lack: sem.profile.",
    "warm_up": "Warm-up gate: protocol.warm_up; without it the run does not wait for slow drift.",
    "adaptive_hold": "Extension of holds: protocol.adaptive_hold; without it every hold lasts `hold_s`.",
}
"""Texts for keys whose class has no docstring that explains them."""


STRICT = (
    "## How the file is read\n",
    "The file is read strictly by the rules of YAML 1.2. An error contains line and key. The same holds for device descriptions",
    "and scenarios.\n",
    "- Refused are a repeated key, a second document, a tag (`!!float`), `<<`, and indentation by tabs.",
    "- A number has no quotes and a decimal point: `300`, `0.5`, `1e-5`. Refused are a leading zero (`0300`, which older readers",
    "  interpret as 192), underscores (`3_0`), numbers to base 60 (`1:30`), a comma between digits (`30,5`, also in `[30,5]`; a list",
    "  has a space after the comma: `[30, 5]`), `.inf` and `.nan`. Text such as a serial number `0012` needs quotes.",
    "- A truth value is `true` or `false`. `yes`, `no`, `on` and `off` are refused; as text they need quotes.",
    "- The file is a regular file of at most 1 MB in UTF-8, with at most 32 nested lists and sections.\n",
)


UNUSUAL = (
    "## `confirmed_unusual`\n",
    "These values are possible but implausible. Most have a wrong unit or a wrong number of digits: a cross-section in cm^2 or m^2,",
    "a stiffness in kN/mm, pixels in nm, times in us, a ramp that is shorter than four readings, a stress above",
    "`specimen.yield_strength_mpa`, a force limit of 100 times the largest load. `semlive plan` and `semlive doctor` show them as",
    "questions. `semlive run` refuses them until they are corrected, or confirmed by their keys:",
    "`confirmed_unusual: [specimen.area_mm2]`. Limits and reasons are in"
    " `semlive/service/config/plausibility.py`. Keys that can be confirmed:\n",
)


def _flowed(*lines: str) -> list[str]:
    """Paragraphs and list items wrapped at 120 characters; a line break at the end of a line ends a paragraph, headings stay."""
    paragraphs: list[str] = []
    begins = True
    for line in lines:
        if begins or line.startswith(("#", "- ")):
            paragraphs.append(line)
        else:
            paragraphs[-1] += " " + line.strip(" ")
        begins = line.endswith("\n")
    wrapped = (textwrap.wrap(item, 120, subsequent_indent="  " * item.startswith("- "), break_on_hyphens=False) for item in paragraphs)
    return ["\n".join(some) + "\n" * item.endswith("\n") for some, item in zip(wrapped, paragraphs, strict=True)]


def cli_page() -> str:
    """Every command with its arguments and options, from its own help."""
    parts = _flowed(
        "# Commands\n",
        "This page is generated from the commands (`tests/golden/test_reference_pages.py`). `semlive COMMAND --help` prints the same.\n",
        "Exit codes: 0 success, 1 a failure or a failed check, 2 invalid input. The last line on standard error states what failed,",
        "where, and what to do. If semlive itself failed, `SEMLIVE_TRACEBACK=1` in the environment shows the place in the code.",
        "`semlive --install-completion` installs tab completion of commands and options (bash, zsh, fish, PowerShell).",
        "`semlive --version` prints the version. [The list of terms](../explanations/method.md#words) explains the terms.\n",
    )
    for entry in COMMANDS:
        command = load(entry)
        inner = getattr(command, "commands", None)
        if not inner:
            parts += _command(f"semlive {entry.name}", command)
        for name, item in (inner or {}).items():
            parts += _command(f"semlive {entry.name} {name}", item)
    return "\n".join(parts) + "\n"


def _command(name: str, command: Any) -> Iterator[str]:
    arguments = [item for item in command.params if item.param_type_name == "argument"]
    options = [item for item in command.params if item.param_type_name == "option" and item.name != "help"]
    hints = typing.get_type_hints(inspect.unwrap(command.callback))
    needed = [item for item in options if item.required]
    places = [_place(item) if item.required else f"[{_place(item)}]" for item in arguments]
    used = " ".join([*places, *(f"{max(item.opts, key=len)} {max(item.opts, key=len).strip('-').upper()}" for item in needed)])
    yield f"## `{f'{name} {used}'.strip()}`\n"
    yield from _flowed(f"{' '.join((command.help or '').split())}\n")
    if not arguments and not options:
        return
    yield "| argument or option | meaning | default |\n|---|---|---|"
    for item in (*arguments, *options):
        words = _place(item) if item in arguments else ", ".join(sorted((*item.opts, *item.secondary_opts), key=len))
        unset = item.default is None or item.default is False or callable(item.default)
        default = "" if unset else f"`{getattr(item.default, 'value', item.default)}`"
        choices = [f"`{choice.value}`" for kind in _kinds(hints.get(item.name)) for choice in kind]
        reported = _cell(item.help or "") + (f" One of {', '.join(choices)}." if choices else "")
        yield f"| `{words}` | {reported} | {'needed' if item.required else default} |"
    yield ""


def _kinds(hint: Any) -> list[type[enum.Enum]]:
    """The enumerations that an option takes its value from."""
    return [item for item in (hint, *typing.get_args(hint)) if inspect.isclass(item) and issubclass(item, enum.Enum)]


def _place(argument: Any) -> str:
    return str(argument.metavar or argument.name.upper()) + ("..." if argument.nargs == -1 and "..." not in str(argument.metavar) else "")


def configuration_page() -> str:
    """Every key of a configuration file: type, default and meaning."""
    parts = _flowed(
        "# Configuration\n",
        "This page is generated from the code that checks a configuration (`tests/golden/test_reference_pages.py`). An unknown key is",
        "refused with the most similar known one. Units are in the names: `_s` seconds, `_px` pixels, `_um`, `_mm`, `_n` newtons,",
        "`_n_s` newtons per second. Times of the protocol are experiment time, which only a simulator runs faster; wall time is the",
        "time of this computer. Folders are relative to the file. A key without default is optional.\n",
        "`semlive init` writes a commented file; [deploy/examples](../../deploy/examples) has three.",
        "[The list of terms](../explanations/method.md#words) explains terms such as POI and ZNCC.\n",
        "Required are `sem` and `protocol`; `load_frame` with `loads_n`, `limits` with a `load_frame`, and `stage` with a shift other",
        "than (0, 0) or with recentring (`recentre_beyond_px`). Without a `load_frame` every key of `limits` has a default: 0 for those",
        "of load and extension, and 1000 for `stage_travel_um`.\n",
        *STRICT,
    )
    for heading, cls in SECTIONS:
        parts += [f"## `{heading}`\n", f"{_cell(_first_line(cls))}\n", *_table(cls)]
    parts += [*_flowed(*UNUSUAL), *(f"- `{key}`" for key in CONFIRMABLE), ""]
    parts += _flowed(
        "## Settings of drivers\n",
        "These keys belong to `settings` of `load_frame`, `stage` and `sem.trigger`. [Drivers](drivers.md) lists the purpose of each",
        "driver. `null` has no settings.\n",
    )
    for title, cls in DRIVERS:
        parts += [f"### {title}\n", *_table(cls)]
    return "\n".join(parts)


def _table(cls: type) -> Iterator[str]:
    """All keys of a section; then an empty line."""
    about = _attribute_words(cls)
    yield "| key | type | default | meaning |\n|---|---|---|---|"
    for name, kind, default in _fields(cls):
        words = re.sub(
            r"\bNone\b(?! of)", "`null`", _cell(about.get(name) or ELSEWHERE.get(f"{cls.__name__}.{name}") or ELSEWHERE.get(name, ""))
        )
        yield f"| `{name}` | {kind} | {default} | {words} |"
    yield ""


def _fields(cls: type) -> Iterator[tuple[str, str, str]]:
    hints = typing.get_type_hints(cls)
    if issubclass(cls, BaseModel):
        for name, field in cls.model_fields.items():
            yield name, _type(hints[name]), _model_default(field)
        return
    for item in dataclasses.fields(cls):
        default = (
            "needed" if item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING else _default(item.default)
        )
        yield item.name, _type(hints[item.name]), default


def _model_default(field: FieldInfo) -> str:
    return "needed" if field.is_required() else _default(field.get_default(call_default_factory=True))


def _default(value: object) -> str:
    if value is None or isinstance(value, BaseModel) or dataclasses.is_dataclass(value):
        return ""
    if isinstance(value, bool):
        return "`true`" if value else "`false`"
    text = value.as_posix() if isinstance(value, Path) else str(list(value)) if isinstance(value, tuple) else str(value)
    return f"`{text}`" if text not in ("", "[]", "{}") else ""


def _type(hint: Any) -> str:
    if typing.get_origin(hint) is typing.Annotated:
        hint = typing.get_args(hint)[0]
    arguments = [item for item in typing.get_args(hint) if item is not type(None)]
    if typing.get_origin(hint) is typing.Literal:
        return " or ".join(str(item) for item in typing.get_args(hint))
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return " or ".join(_type(item) for item in arguments)
    if inspect.isclass(hint) and issubclass(hint, enum.Enum):
        return " or ".join(str(item.value) for item in hint)
    if typing.get_origin(hint) in (list, tuple):
        return (
            f"list of {_type(arguments[0])}"
            if typing.get_origin(hint) is list or arguments[-1] is Ellipsis
            else f"{len(arguments)} numbers"
        )
    if typing.get_origin(hint) is dict or (inspect.isclass(hint) and (issubclass(hint, BaseModel) or dataclasses.is_dataclass(hint))):
        return "section"
    return {float: "number", int: "whole number", str: "text", bool: "true or false", Path: "path"}.get(hint, "section")


def _attribute_words(cls: type) -> dict[str, str]:
    """Texts of a class on its attributes: under ``Attributes:``, or by the string below each."""
    found: dict[str, str] = {}
    for match in re.finditer(
        r"^    (\w+): (.*?)(?=^    \w+: |\Z)", inspect.cleandoc(cls.__doc__ or "").partition("Attributes:\n")[2], re.M | re.S
    ):
        found[match[1]] = " ".join(match[2].split())
    for item in (base for base in reversed(cls.__mro__) if base.__module__.startswith("semlive")):
        body = ast.parse(inspect.getsource(item)).body[0]
        assert isinstance(body, ast.ClassDef)
        for before, after in zip(body.body, body.body[1:], strict=False):
            named = isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name)
            if named and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                found[before.target.id] = " ".join(str(after.value.value).split())  # type: ignore[union-attr]
    return {name: words[0].upper() + words[1:] for name, words in found.items()}


def _first_line(cls: type) -> str:
    return inspect.cleandoc(cls.__doc__ or "").split("\n\n")[0].replace("\n", " ")


def _cell(text: str) -> str:
    return re.sub(r"<(\w+)>", r"\\<\1>", " ".join(text.split()).replace("``", "`").replace("|", "\\|"))


PAGES = {"cli.md": cli_page, "configuration.md": configuration_page}


@pytest.mark.checkout
@pytest.mark.parametrize("name", PAGES)
def test_the_page_reports_what_the_code_reports(name: str) -> None:
    assert (DOCS / name).read_text(encoding="utf-8") == PAGES[name]()


def test_every_key_of_a_configuration_is_explained() -> None:
    rows = re.findall(r"^\| `(\w+)` \|.*\| (.*) \|$", configuration_page(), re.MULTILINE)
    assert len(rows) > 80
    assert [name for name, words in rows if not words] == []


if __name__ == "__main__":
    for page, write in PAGES.items():
        (DOCS / page).write_text(write(), encoding="utf-8")
        sys.stdout.write(f"{page} is written\n")
