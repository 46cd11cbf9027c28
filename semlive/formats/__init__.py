"""Bytes to values and back: export files, log messages, logs. Nothing here opens a path."""

from semlive.formats.images.frames import SIDECAR_VENDORS, check_complete, check_finished, ends_like_partial_file, read_frame, read_info

__all__ = ["SIDECAR_VENDORS", "check_complete", "check_finished", "ends_like_partial_file", "read_frame", "read_info"]
