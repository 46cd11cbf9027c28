"""`semlive dic`: disparity between image files, without daemon or log."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from semlive import dic as engine
from semlive.cli.shared.output_path import output_file, output_folder
from semlive.cli.shared.progress_bar import compile_with_progress
from semlive.cli.shared.terminal import echo
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.settings import DicSettings
from semlive.errors import BadInput
from semlive.formats.images.image_files import read_picture
from semlive.inputs.files import MAX_IMAGE_BYTES, read_regular

QUALITY_CHECK_MAX_PX = 2048  # largest edge of the part of the reference whose pattern quality is evaluated
HEADER = "x,y,u,v,sigma_u,sigma_v,zncc,status"
GLOBAL_NOTE = "subsets measure too few points of this texture; the global method measures them with a smooth field"
Image = NDArray[np.uint8] | NDArray[np.uint16]


def dic(
    ref: Annotated[Path, typer.Argument(help="Reference image.", show_default=False)],
    cur: Annotated[list[Path], typer.Argument(help="Current images.", show_default=False)],
    subset: Annotated[int, typer.Option(help="Edge of the square subset in px, odd.")] = 43,
    step: Annotated[int, typer.Option(help="Distance of neighbouring points in px.")] = 5,
    roi: Annotated[
        str | None, typer.Option(help="First and last possible subset centres, x0,y0,x1,y1; by default the complete frame.")
    ] = None,
    mask: Annotated[Path | None, typer.Option(help="Image with the size of the reference, 0 where the reference must not be used.")] = None,
    interpolation: Annotated[
        str, typer.Option(help="Spline of the interpolation: cubic, or quintic (a third of the bias in twice the time).")
    ] = "cubic",
    shape: Annotated[
        str,
        typer.Option(
            help="Shape function: affine, quadratic (represents strain gradients, twice the noise) or quartic (three times the noise)."
        ),
    ] = "affine",
    search: Annotated[
        float | None,
        typer.Option(
            help="Largest possible motion in px along x or y, if known; regular patterns can then be measured up to half their pitch."
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            help="Method: subset, global (one smooth field, for weak texture), or auto (global if subsets measure too few points)."
        ),
    ] = "auto",
    page: Annotated[int | None, typer.Option(min=1, help="Which image of TIFF files that contain several, from 1.")] = None,
    out: Annotated[Path | None, typer.Option(help="CSV file to write; a folder if there are several current images.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Correlate images (TIFF, PNG, JPEG, BMP...) with a reference: x_current = x + u, in px."""
    settings = _settings(subset, step, roi, interpolation, shape, search, method)
    image = _read(ref, page)
    used = None if mask is None else _read_same_size(mask, ref, image) > 0
    engine.grid_for(settings, image.shape[1], image.shape[0])  # reject settings that do not fit before anything is decoded
    for path in cur:
        _read_same_size(path, ref, image, page)  # reject a wrong file before the correlation; decoding takes a thirtieth of its time
    files = _output_files(out, cur)
    compile_with_progress(settings)
    for warning in _poor(image, settings, used):
        echo(f"{ref}: {warning}", err=True)
    figures = _correlate_files(ref, cur, files, image, used, settings, as_json, page)
    if as_json:
        typer.echo(json.dumps(figures[0] if len(figures) == 1 else figures))
    _fail_without_points(cur, figures)


def _correlate_files(
    ref: Path,
    cur: list[Path],
    files: list[Path],
    image: Image,
    used: NDArray[np.bool_] | None,
    settings: DicSettings,
    as_json: bool,
    page: int | None,
) -> list[dict[str, object]]:
    """Correlate each current image; write its CSV file, print its line, and return the figures for JSON."""
    grid = engine.grid_for(settings, image.shape[1], image.shape[0])
    start = time.perf_counter()
    reference = None if engine.is_large(image.shape, grid) else engine.prepare(image, grid, settings, used)
    prepared_s = time.perf_counter() - start
    figures: list[dict[str, object]] = []
    for number, path in enumerate(_with_progress(cur), start=1):
        current = _read_same_size(path, ref, image, page)
        start = time.perf_counter()
        if reference is None:
            disparity = engine.correlate_tiled(image, current, grid, settings, mask=used, current_frame=number)
        else:
            disparity = engine.correlate(reference, current, settings, reference_frame=0, current_frame=number)
        wall_s = time.perf_counter() - start + prepared_s
        prepared_s = 0.0  # the reference is prepared once; its time is counted with the first image
        if settings.method == "auto" and disparity.method == "global":
            echo(f"{path}: {GLOBAL_NOTE}", err=True)
        if files:
            _write(files[number - 1], disparity)
        figures.append(_figures(disparity, settings, wall_s))
        if not as_json:
            echo(_summary_line(path, disparity, wall_s))
        if engine.has_few_points(disparity):
            reason = engine.explain_no_points(image, current, disparity, settings, mask=used)
            figures[-1]["reason"] = _warn(path, disparity, reason)
    return figures


def _warn(path: Path, disparity: DisparityMap, reason: engine.NoPointsReason) -> dict[str, str]:
    """Print the reason for few points or none; return it for JSON."""
    found = int(disparity.valid.sum())
    echo(f"{path}: {f'few points ({found}) were' if found else 'no point was'} found: {reason}", err=True)
    return {"cause": reason.cause.value, "text": reason.text, "remedy": reason.remedy}


def _fail_without_points(cur: list[Path], figures: list[dict[str, object]]) -> None:
    """End with exit code 1 if an image has no point; of several images name those."""
    lost = [path.name for path, figure in zip(cur, figures, strict=True) if figure["converged"] == 0]
    if lost and len(cur) > 1:
        echo(f"{len(lost)} of {len(cur)} images have no point: {', '.join(lost)}", err=True)
    if lost:
        raise typer.Exit(1)


def _poor(image: Image, settings: DicSettings, used: NDArray[np.bool_] | None) -> tuple[str, ...]:
    """Warnings about the pattern of the reference image, from adjacent subsets; of a large image its central part."""
    (first_row, height), (first_column, width) = (
        (max(0, (n - QUALITY_CHECK_MAX_PX) // 2), min(n, QUALITY_CHECK_MAX_PX)) for n in image.shape
    )
    part = np.s_[first_row : first_row + height, first_column : first_column + width]
    roi = None
    if settings.roi_px is not None:
        x0, y0, x1, y1 = settings.roi_px
        roi = (x0 - first_column, y0 - first_row, x1 - first_column, y1 - first_row)
    try:
        sparse = dataclasses.replace(settings, step_px=max(settings.step_px, settings.subset_px), roi_px=roi)
        grid = engine.grid_for(sparse, width, height)
        return engine.quality(image[part], grid, sparse, mask=None if used is None else used[part]).warnings
    except BadInput:  # no subset lies in the central part, or the mask excludes it
        return ()


def _with_progress(paths: list[Path]) -> Iterator[Path]:
    """Yield the paths; show a progress bar on standard error, or one line for each path if it is no terminal."""
    console = Console(stderr=True)
    if console.is_terminal:
        with Progress(console=console, transient=True) as progress:
            yield from progress.track(paths, description="correlating")
        return
    for number, path in enumerate(paths, start=1):
        echo(f"correlating {number} of {len(paths)}: {path.name}", err=True)
        yield path


def _settings(subset: int, step: int, roi: str | None, interpolation: str, shape: str, search: float | None, method: str) -> DicSettings:
    corners: tuple[int, int, int, int] | None = None
    if roi is not None:
        try:
            x0, y0, x1, y1 = (int(word) for word in roi.split(","))
        except ValueError:
            raise BadInput(f"--roi {roi}: is not four whole numbers; write x0,y0,x1,y1 as in --roi 101,101,846,696.") from None
        corners = (x0, y0, x1, y1)
    splines: dict[str, Literal["cubic", "quintic"]] = {"cubic": "cubic", "quintic": "quintic"}
    shapes: dict[str, Literal["affine", "quadratic", "quartic"]] = {"affine": "affine", "quadratic": "quadratic", "quartic": "quartic"}
    methods: dict[str, Literal["auto", "subset", "global"]] = {"auto": "auto", "subset": "subset", "global": "global"}
    for option, word, choices in (
        ("--interpolation", interpolation, splines),
        ("--shape", shape, shapes),
        ("--method", method, methods),
    ):
        if word not in choices:
            raise BadInput(f"{option} {word}: no such choice; give {', '.join(list(choices)[:-1])} or {list(choices)[-1]}.")
    if search is not None and not search > 0.0:
        raise BadInput(f"--search {search:g}: must be more than 0; give the largest motion in px, or leave the option out.")
    try:
        return DicSettings(
            subset_px=subset,
            step_px=step,
            roi_px=corners,
            interpolation=splines[interpolation],
            shape_function=shapes[shape],
            search_px=search,
            method=methods[method],
        )
    except ValueError as error:
        raise BadInput(f"--subset {subset} --step {step}: {error}.") from error


def _read(path: Path, page: int | None = None) -> Image:
    try:
        data = read_regular(path, MAX_IMAGE_BYTES)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give an image file that exists.") from error
    return read_picture(data, str(path), page)


def _read_same_size(path: Path, ref: Path, reference: Image, page: int | None = None) -> Image:
    """Read a current image or a mask.

    Raises:
        BadInput: its size differs from that of the reference.
    """
    image = _read(path, page)
    (height, width), (h1, w1) = reference.shape, image.shape
    if (height, width) != (h1, w1):
        raise BadInput(f"{path}: is {w1} x {h1} px but {ref} is {width} x {height} px; export all frames with the same size and databar.")
    return image


def _output_files(out: Path | None, cur: list[Path]) -> list[Path]:
    """Paths of the CSV files, one for each current image; their folder is made and checked before the correlation starts."""
    if out is None:
        return []
    if len(cur) == 1:
        return [output_file(out, "--out")]
    output_folder(out, "--out").mkdir(parents=True, exist_ok=True)
    names = [f"{path.stem}.csv" for path in cur]
    if len(set(names)) < len(names):
        names = [f"{number:03d}_{name}" for number, name in enumerate(names, start=1)]
    return [out / name for name in names]


def _write(path: Path, disparity: DisparityMap) -> None:
    x, y = disparity.grid.mesh()
    m = disparity
    columns = [a.ravel().tolist() for a in (x, y, m.u_px, m.v_px, m.sigma_u_px, m.sigma_v_px, m.zncc, m.status)]
    header, shares = HEADER, [""] * m.status.size
    if m.neighbour_share is not None:
        header, shares = f"{HEADER},neighbour_share", [f",{share:.4f}" for share in m.neighbour_share.ravel().tolist()]
    words = {int(status): status.label for status in PoiStatus}
    lines = [
        f"{x:.0f},{y:.0f},{u:.6f},{v:.6f},{su:.6f},{sv:.6f},{zncc:.6f},{words[status]}{share}"
        for x, y, u, v, su, sv, zncc, status, share in zip(*columns, shares, strict=True)
    ]
    try:
        path.write_text("\n".join([header, *lines, ""]), encoding="ascii", newline="\n")
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); give a path that can.") from error


def _figures(disparity: DisparityMap, settings: DicSettings, wall_s: float) -> dict[str, object]:
    return {
        "points": int(disparity.status.size),
        "converged": int(disparity.valid.sum()),
        "wall_s": round(wall_s, 6),
        "subset_px": settings.subset_px,
        "step_px": settings.step_px,
        "method": disparity.method,
    }


def _summary_line(path: Path, disparity: DisparityMap, wall_s: float) -> str:
    """Summary of the correlation of one image."""
    valid = disparity.valid
    count = int(valid.sum())
    if count == 0:
        return f"{path}: none of {valid.size} points found in {wall_s:.2f} s"
    u, v = np.median(disparity.u_px[valid]), np.median(disparity.v_px[valid])
    sigma = np.median(disparity.sigma_u_px[valid])
    return f"{path}: {count} of {valid.size} points in {wall_s:.2f} s, median shift ({u:+.3f}, {v:+.3f}) px, noise {sigma:.4f} px"
