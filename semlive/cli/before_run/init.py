"""`semlive init`: write a configuration after a few questions."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, get_args

import typer

from semlive.cli.before_run.region import region_answer
from semlive.cli.shared.output_path import output_file, write_bytes, write_text
from semlive.cli.shared.terminal import echo
from semlive.errors import BadConfig
from semlive.inputs.yaml_text import read_yaml
from semlive.service.config.configuration import checked_text
from semlive.service.config.template import LAB_PRESETS, FrameKind, LabSetup, Vendor, configuration_text, host_and_port

_QUESTIONS = {
    "name": "Name of the run",
    "export_folder": "Folder into which the SEM saves its frames",
    "vendor": f"Vendor of the SEM ({', '.join(get_args(Vendor))})",
    "pixel_size_um": "Edge of a pixel on the specimen, um",
    "frame": f"Load frame ({', '.join(get_args(FrameKind))})",
    "address": "Its address: host, serial port, or the program that the operator uses",
    "specimen": "Specimen",
    "area_mm2": "Its cross-section, mm^2",
    "loading_axis": "Image axis of the load (x, y)",
    "max_load_n": "Largest load, N",
    "load_steps": "Number of loads",
}
_MAX_LOADS = 500
"""More are written into the configuration by hand."""


def init(
    out: Annotated[Path, typer.Argument(help="File to write.")] = Path("semlive.yaml"),
    lab: Annotated[str, typer.Option(help=f"Kind of laboratory to start from: {', '.join(LAB_PRESETS)}.")] = "modbus-fei",
    yes: Annotated[
        bool, typer.Option("--yes", help="Ask no questions: use the options, and the usual values of such a laboratory.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    name: Annotated[str | None, typer.Option(help="Name of the run.")] = None,
    export_folder: Annotated[str | None, typer.Option(help="Folder into which the SEM saves.")] = None,
    vendor: Annotated[str | None, typer.Option(help=f"Vendor of the SEM: {', '.join(get_args(Vendor))}.")] = None,
    pixel_size_um: Annotated[float | None, typer.Option(help="Edge of a pixel on the specimen, um.")] = None,
    frame: Annotated[str | None, typer.Option(help=f"Load frame: {', '.join(get_args(FrameKind))}.")] = None,
    address: Annotated[str | None, typer.Option(help="Host, serial port, or program of the load frame.")] = None,
    specimen: Annotated[str | None, typer.Option(help="Name of the specimen.")] = None,
    area_mm2: Annotated[float | None, typer.Option(help="Its cross-section, mm^2.")] = None,
    loading_axis: Annotated[str | None, typer.Option(help="Image axis of the load: x or y.")] = None,
    max_load_n: Annotated[float | None, typer.Option(help="Largest load, N.")] = None,
    load_steps: Annotated[int | None, typer.Option(help="Number of loads.")] = None,
    test_frame: Annotated[
        Path | None, typer.Option("--test-frame", help="One frame of the specimen, on which region and masks are drawn.")
    ] = None,
    region: Annotated[
        str | None, typer.Option(help="First and last subset centre x0,y0,x1,y1 in px; by default from the size of --test-frame.")
    ] = None,
    draw: Annotated[bool | None, typer.Option("--draw/--no-draw", help="Draw on --test-frame in the browser.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a commented configuration after a few questions."""
    if lab not in LAB_PRESETS:
        raise BadConfig(f"--lab {lab}: no such kind of laboratory; give one of {', '.join(LAB_PRESETS)}")
    if out.exists() and not force:
        raise BadConfig(f"{out}: the file exists; give another name, or --force to overwrite it")
    if test_frame is None and (region is not None or draw is not None):
        raise BadConfig("--region and --draw need --test-frame, whose size limits the region")
    options = locals()
    output_file(out, "FILE")
    given = {key: options[key] for key in _QUESTIONS if options[key] is not None}
    answers = _changed(LAB_PRESETS[lab], given, str(out))
    if not yes:
        answers = _answered(answers, frozenset(given), str(out))
    written = {"configuration": str(out)}
    if test_frame is not None:
        placed = region_answer(test_frame, region, draw, not yes)
        answers = _changed(answers, {"region_px": placed.region_px}, str(out))
        if placed.mask is not None:
            mask = out.with_name(f"{out.stem}-mask.png")
            write_bytes(mask, placed.mask)
            written["mask"] = str(mask)
            answers = _changed(answers, {"mask": mask.name}, str(out))
    write_text(out, configuration_text(answers))
    if as_json:
        typer.echo(json.dumps(written))
        return
    if "mask" in written:
        typer.echo(f"wrote {written['mask']}, which the configuration names as dic.mask")
    typer.echo(f"wrote {out}; next: semlive doctor {out}, then semlive plan {out} --test-frame {test_frame or 'FILE'}")


def _answered(answers: LabSetup, given: frozenset[str], file: str) -> LabSetup:
    """Ask for the answers that no option gives; a question is repeated until its answer is valid, and no other answer is lost."""
    for key, question in _QUESTIONS.items():
        if key in given or (key in ("address", "area_mm2", "max_load_n", "load_steps") and answers.frame == "none"):
            continue
        usual = getattr(answers, key)
        while True:
            try:
                answers = _changed(answers, {key: typer.prompt(question, default=usual, type=type(usual))}, file)
                break
            except BadConfig as error:
                echo(f"{error}; the other answers are kept", err=True)
    return answers


def _changed(answers: LabSetup, values: dict[str, object], file: str) -> LabSetup:
    """Answers with other values.

    Raises:
        BadConfig: a value is not valid, or the configuration made from the answers is not.
    """
    changed = dataclasses.replace(answers, **values)  # type: ignore[arg-type]  (checked below)
    for key, allowed in (("vendor", get_args(Vendor)), ("frame", get_args(FrameKind)), ("loading_axis", ("x", "y"))):
        if getattr(changed, key) not in allowed:
            raise BadConfig(f"{key} {getattr(changed, key)}: no such choice; give one of {', '.join(allowed)}")
    for key in ("pixel_size_um", "area_mm2", "max_load_n"):
        if not getattr(changed, key) > 0:
            raise BadConfig(f"{key} must be more than 0, not {getattr(changed, key)}")
    host, port = host_and_port(changed.address)
    if changed.frame != "none" and not host.strip():
        raise BadConfig("address is empty; give the host, the serial port, or the name of the program")
    if changed.frame == "modbus" and port and not (port.isdecimal() and 0 < int(port) < 65536):
        raise BadConfig(f"address {changed.address}: port {port} is not 1 to 65535; give HOST, HOST:PORT or [IPv6 ADDRESS]:PORT")
    if not 2 <= changed.load_steps <= _MAX_LOADS:
        raise BadConfig(f"load_steps must be 2 to {_MAX_LOADS}, not {changed.load_steps}")
    checked_text(read_yaml(configuration_text(changed), file), file)
    return changed
