"""What `semlive inspect --json` prints, held to the letter.

Run ``python tests/golden/test_inspect.py`` to write it again after a deliberate change; it may only ever be extended.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile, ScanSpeed
from semlive.formats.images.inspection import as_json, inspect_file
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.scenario import load_scenario

GOLDEN = Path(__file__).with_name("inspect.json")
END_NS = 1_772_439_825_123_456_789
PROFILE = ScanProfile(speeds=(ScanSpeed("9", row_time_s=0.108, dwell_time_s=1e-4),))


def printed() -> dict[str, object]:
    """A file of each vendor, and one cut short."""
    scan: Scan = load_scenario("paper_x200").scan
    image = np.random.default_rng(1).integers(0, 256, (scan.height_px, scan.width_px), dtype=np.uint8)
    files: list[dict[str, object]] = []
    for vendor in Vendor:
        name = f"frame.{vendor.value}"
        made = Export(WriteStyle.DIRECT, 0.5, 1.5, 6, 60, "a", vendor).encode(
            image, ImageMetadata(scan, END_NS, 12.5, -3.25, frame=4, name=name)
        )
        file = ExportedFile(0, name, made.image, "", END_NS, END_NS, made.sidecar)
        files.append(as_json(inspect_file(file, PROFILE), name))
        if vendor is Vendor.FEI:
            cut = ExportedFile(0, name, made.image[:-100], "", END_NS, END_NS)
            files.append(as_json(inspect_file(cut, PROFILE), "cut"))
            half = ExportedFile(0, name, made.image[: len(made.image) // 2], "", END_NS, END_NS)
            files.append(as_json(inspect_file(half, PROFILE), "half"))
    return {"files": files}


def test_what_inspect_prints_is_the_golden_one() -> None:
    assert json.loads(json.dumps(printed())) == json.loads(GOLDEN.read_text(encoding="utf-8"))


if __name__ == "__main__":
    sys.stdout.write(f"{GOLDEN}\n")
    GOLDEN.write_text(json.dumps(printed(), indent=1) + "\n", encoding="utf-8")
