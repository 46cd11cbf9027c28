"""Recording of a log: the queue of messages, the segment on the disk, and the recorder thread between them."""

from __future__ import annotations

from semlive.service.log.recording.recorder import FLUSH_EVERY_S, Recorder
from semlive.service.log.recording.segment import REWRITING
from semlive.service.log.recording.stream import is_being_written, open_new, sync_folder

__all__ = ["FLUSH_EVERY_S", "REWRITING", "Recorder", "is_being_written", "open_new", "sync_folder"]
