"""The client of AutoScript as its manual describes it; shares no code with the driver."""

from __future__ import annotations

import types
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace as Node
from typing import Any


def electron_beam() -> Any:
    return Node(
        is_on=True,
        is_blanked=False,
        horizontal_field_width=Node(value=1.28e-4),
        scanning=Node(dwell_time=Node(value=1e-6), resolution=Node(value="1536x1024"), rotation=Node(value=0.0), mode=Node(value=1)),
        angular_correction=Node(tilt_correction=Node(is_on=False), dynamic_focus=Node(is_on=False)),
    )


@dataclass
class AutoScript:
    """A microscope with its server; `scan` returns (columns, rows, dwell time in s) of the frame that it really scans."""

    beam: Any = field(default_factory=electron_beam)
    device: int = 1
    answers: bool = True
    line_time: float | None = 1.6e-3
    dwell_of_image: float | None = 1e-6
    size_of_image: tuple[int, int] = (1536, 1024)
    during_scan: Callable[[], object] = lambda: None
    write: Callable[[Path], object] = lambda path: path.write_bytes(b"image")
    calls: list[str] = field(default_factory=list)


def module(microscope: AutoScript) -> dict[str, types.ModuleType]:
    """The package of the client."""

    class GrabFrameSettings:
        def __init__(self, *, bit_depth: int) -> None:
            self.bit_depth = bit_depth

    class Client:
        def __init__(self) -> None:
            self.beams = Node(electron_beam=microscope.beam)
            self.imaging = Node(get_active_device=lambda: microscope.device, grab_frame=self._grab_frame)

        def connect(self, *address: object) -> None:
            microscope.calls.append(f"connect{address}")
            if not microscope.answers:
                raise ConnectionError("the server is not running")

        def disconnect(self) -> None:
            microscope.calls.append("disconnect")

        def _grab_frame(self, settings: GrabFrameSettings | None = None) -> Any:
            microscope.calls.append(f"grab_frame {8 if settings is None else settings.bit_depth}")
            microscope.during_scan()
            scan = Node(dwell_time=microscope.dwell_of_image, line_time=microscope.line_time)
            width, height = microscope.size_of_image
            return Node(width=width, height=height, metadata=Node(scan_settings=scan), save=lambda path: microscope.write(Path(path)))

    package, structures = types.ModuleType("autoscript_sdb_microscope_client"), types.ModuleType("structures")
    vars(package).update(SdbMicroscopeClient=Client)
    vars(structures).update(GrabFrameSettings=GrabFrameSettings)
    return {package.__name__: package, f"{package.__name__}.structures": structures}
