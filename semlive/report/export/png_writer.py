"""Pictures: one sheet of maps with colour bars for each frame, drift, distortion, stress over strain."""

from __future__ import annotations

from pathlib import Path

from semlive.data.results import FrameResult
from semlive.report import figures
from semlive.report.export.csv_writer import write_json_files
from semlive.report.export.fields import RunMetadata


class PngWriter:
    """A folder of pictures.

    ``frame_<n>.png``, ``drift.png``, ``distortion.png``; ``load.png`` and ``stress_strain.png`` where there are loads.
    """

    def __init__(self, out: Path) -> None:
        self._out, self._sheet = out, figures.FieldSheet()
        out.mkdir(parents=True, exist_ok=True)

    def write_frame(self, frame: FrameResult) -> None:
        """Draw displacement and strain of one frame."""
        summary = frame.summary
        title = f"frame {summary.frame}, virtual strain gauge {summary.vsg_px:.0f} px"
        (self._out / f"frame_{summary.frame:05d}.png").write_bytes(figures.png(self._sheet.draw(frame, title)))

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Draw the rest."""
        drawn = {"drift": figures.drift_over_time(metadata.result), "distortion": figures.distortion_fields(metadata.result)}
        if metadata.load is not None and metadata.load.time_ns.size:
            drawn["load"] = figures.load_over_time(metadata.load, metadata.result)
        area_mm2 = metadata.settings["specimen.area_mm2"]
        curve = None if area_mm2 is None else figures.stress_strain(metadata.result, area_mm2, metadata.settings["specimen.loading_axis"])
        if curve is not None:
            drawn["stress_strain"] = curve
        for name, figure in drawn.items():
            (self._out / f"{name}.png").write_bytes(figures.png(figure))
        write_json_files(self._out, metadata)

    def close(self, complete: bool) -> None:
        """Do nothing: no file is open."""
