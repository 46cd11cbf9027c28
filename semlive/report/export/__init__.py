"""A log's fields and series in the formats of other programs, frame by frame."""

from semlive.report.export.fields import Format, Story, Writer
from semlive.report.export.log import export_log

__all__ = ["Format", "Story", "Writer", "export_log"]
