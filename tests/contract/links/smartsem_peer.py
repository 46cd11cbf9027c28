"""The COM object of SmartSEM as its public clients describe it: parameters, commands, codes; shares no code with the driver."""

from __future__ import annotations

import threading
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

VT_R4, VT_BSTR = 4, 8


@dataclass
class Variant:
    """A value of COM with its type."""

    kind: int
    value: object


@dataclass
class SmartSem:
    """The object ``CZ.EMApiCtrl.1``: texts as displayed, numbers in base units, and what was commanded."""

    texts: dict[str, str] = field(
        default_factory=lambda: {
            "DP_RUNUPSTATE": "Beam On",
            "DP_BEAM_BLANKED": "No",
            "DP_IMAGE_STORE": "1024*768",
            "AP_LINE_TIME": "5.376 ms",
            "DP_FROZEN": "Live",
            "DP_NOISE_REDUCTION": "Line Avg",
            "DP_SCANRATE": "7",
            "SV_SERIAL_NUMBER": "Merlin-61-50",
        }
    )
    numbers: dict[str, float] = field(default_factory=lambda: {"AP_WIDTH": 2.858e-4, "AP_SCANROTATION": 0.0})
    connects: int = 0
    polls: int = 3
    """Readings of ``DP_FROZEN`` until the frame is complete."""
    write: Callable[[Path], object] = lambda path: path.write_bytes(b"image")
    after_scan: Callable[[], object] = lambda: None
    grab_code: int = 0
    commands: list[str] = field(default_factory=list)
    threads: set[int] = field(default_factory=set)
    _frozen_in: int | None = None

    def InitialiseRemoting(self) -> int:  # noqa: N802
        self.threads.add(threading.get_ident())
        return self.connects

    def ClosingControl(self) -> int:  # noqa: N802
        self.commands.append("ClosingControl")
        return 0

    def Get(self, name: str, variant: Variant) -> tuple[int, object]:  # noqa: N802
        if threading.get_ident() not in self.threads:
            raise RuntimeError("The application called an interface that was marshalled for a different thread.")
        if name == "DP_FROZEN" and self._frozen_in is not None:
            self._frozen_in -= 1
            if self._frozen_in <= 0:
                self.texts["DP_FROZEN"], self._frozen_in = "Frozen", None
                self.after_scan()
        values: dict[str, Any] = self.numbers if variant.kind == VT_R4 else self.texts
        return (0, values[name]) if name in values else (1000, variant.value)

    def Set(self, name: str, variant: Variant) -> tuple[int, object]:  # noqa: N802
        self.commands.append(f"{name}={variant.value}")
        return 0, variant.value

    def Execute(self, name: str) -> int:  # noqa: N802
        self.commands.append(name)
        if name == "CMD_UNFREEZE_ALL":
            self.texts["DP_FROZEN"] = "Live"
        elif name == "CMD_FREEZE_ALL":
            self._frozen_in = self.polls
        else:
            return 1011
        return 0

    def Grab(self, x: int, y: int, width: int, height: int, reduction: int, path: str) -> int:  # noqa: N802
        self.commands.append("Grab")
        assert (x, y, width, height, reduction) == (0, 0, 1024, 768, 0)
        if not self.grab_code:
            self.write(Path(path))
        return self.grab_code


def modules(api: SmartSem) -> dict[str, types.ModuleType]:
    """The modules of pywin32 that a client imports."""
    com, package, client = (types.ModuleType(name) for name in ("pythoncom", "win32com", "win32com.client"))
    vars(com).update(VT_R4=VT_R4, VT_BSTR=VT_BSTR, CoInitialize=lambda: None, CoUninitialize=lambda: None)

    def dispatch(prog_id: str) -> SmartSem:
        assert prog_id == "CZ.EMApiCtrl.1"
        return api

    vars(client).update(Dispatch=dispatch, VARIANT=Variant)
    vars(package).update(client=client)
    return {"pythoncom": com, "win32com": package, "win32com.client": client}
