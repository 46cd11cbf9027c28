"""`semlive init`: write a configuration after a few questions."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, get_args

import typer

from semlive.errors import BadConfig
from semlive.inputs.yaml_text import read_yaml
from semlive.service.config.configuration import checked_text
from semlive.service.config.template import LAB_PRESETS, FrameKind, LabSetup, Vendor, configuration_text

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
) -> None:
    """Write a commented configuration after a few questions."""
    if lab not in LAB_PRESETS:
        raise BadConfig(f"--lab {lab}: no such kind of laboratory; give one of {', '.join(LAB_PRESETS)}")
    if out.exists() and not force:
        raise BadConfig(f"{out}: the file exists; give another name, or --force to overwrite it")
    options = locals()
    given = {key: options[key] for key in _QUESTIONS if options[key] is not None}
    answers = _answered(LAB_PRESETS[lab], given, ask=not yes)
    text = configuration_text(answers)
    checked_text(read_yaml(text, str(out)), str(out))  # the written configuration is valid
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text, encoding="utf-8")
    typer.echo(f"wrote {out}; next: semlive doctor {out}, then semlive plan {out} --test-frame FILE")


def _answered(usual: LabSetup, given: dict[str, object], *, ask: bool) -> LabSetup:
    """Answers of the operator.

    Args:
        usual: default answers.
        given: answers from options.
        ask: prompt for the other answers.

    Raises:
        BadConfig: an answer is not valid.
    """
    answers = dataclasses.replace(usual, **given)  # type: ignore[arg-type]  (checked below)
    for key, question in _QUESTIONS.items() if ask else ():
        if key in given or (key in ("address", "area_mm2", "max_load_n", "load_steps") and answers.frame == "none"):
            continue
        before = getattr(answers, key)
        answers = dataclasses.replace(answers, **{key: typer.prompt(question, default=before, type=type(before))})
    for key, allowed in (("vendor", get_args(Vendor)), ("frame", get_args(FrameKind)), ("loading_axis", ("x", "y"))):
        if getattr(answers, key) not in allowed:
            raise BadConfig(f"{key} {getattr(answers, key)}: no such choice; give one of {', '.join(allowed)}")
    for key in ("pixel_size_um", "area_mm2", "max_load_n"):
        if not getattr(answers, key) > 0:
            raise BadConfig(f"{key} must be more than 0, not {getattr(answers, key)}")
    return answers
