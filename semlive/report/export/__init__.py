"""A log's fields and series in the formats of other programs, frame by frame."""

from semlive.report.export.export import export_log
from semlive.report.export.fields import Format, RunMetadata, Writer

__all__ = ["Format", "RunMetadata", "Writer", "export_log"]
