"""Bytes to values and back: export files, log messages, logs. Nothing here opens a path."""

from semlive.formats.frames import check_complete, read_frame, read_info

__all__ = ["check_complete", "read_frame", "read_info"]
