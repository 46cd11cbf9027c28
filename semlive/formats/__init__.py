"""Bytes to values and back: export files, log messages, logs. Nothing here opens a path."""

from semlive.formats.frames import SIDECAR_VENDORS, check_complete, check_finished, may_be_unfinished, read_frame, read_info

__all__ = ["SIDECAR_VENDORS", "check_complete", "check_finished", "may_be_unfinished", "read_frame", "read_info"]
