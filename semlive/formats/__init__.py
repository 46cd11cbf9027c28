"""Bytes to values and back: export files, log messages, logs. Nothing here opens a path."""

from semlive.formats.images.completeness import CompletenessProof, prove_complete
from semlive.formats.images.frames import SIDECAR_VENDORS, check_complete, check_finished, ends_like_partial_file, read_frame, read_info

__all__ = [
    "SIDECAR_VENDORS",
    "CompletenessProof",
    "check_complete",
    "check_finished",
    "ends_like_partial_file",
    "prove_complete",
    "read_frame",
    "read_info",
]
