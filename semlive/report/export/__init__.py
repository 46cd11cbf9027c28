"""A log's fields and series in the formats of other programs, frame by frame."""

from semlive.report.export.archive.deposit import Deposit, read_deposit
from semlive.report.export.export import DESCRIBED, ONE_FILE, export_log
from semlive.report.export.fields import Format, RunMetadata, Writer

__all__ = ["DESCRIBED", "ONE_FILE", "Deposit", "Format", "RunMetadata", "Writer", "export_log", "read_deposit"]
