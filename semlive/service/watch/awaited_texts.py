"""Text files that an image must have: its vendor's, or the row starts of an instrument's own clock; and what follows if none comes."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.formats import SIDECAR_VENDORS
from semlive.formats.metadata.row_clock import is_row_clock
from semlive.service.watch.watch_settings import WatchSettings


@dataclass(frozen=True, slots=True)
class MissingText:
    """A text file that an image does not have yet.

    Attributes:
        reason: what follows if it does not come within `sidecar_timeout_s`, a clause with the remedy.
        is_needed: the image is rejected without it; otherwise it is used.
    """

    reason: str
    is_needed: bool


def awaits_texts(settings: WatchSettings) -> bool:
    """Whether every image is awaited with a text file, so that its own bytes never prove that nothing follows."""
    return settings.vendor in SIDECAR_VENDORS or settings.row_clock != "if_present"


def missing_text(settings: WatchSettings, text: bytes | None) -> MissingText | None:
    """Return the text file that an image lacks, or None.

    Args:
        settings: vendor of the files, and use of the row clock.
        text: content of the text file of the image; None without one.
    """
    if settings.vendor in SIDECAR_VENDORS and text is None:
        advice = "switch the export of image information on, or raise sem.sidecar_timeout_s"
        return MissingText(f"never got the text file that {settings.vendor} writes for it; {advice}", True)
    if settings.row_clock == "if_present" or (text is not None and is_row_clock(text)):
        return None
    never = "never got a text file with row_start_s" if text is None else "has a text file without row_start_s"
    if settings.row_clock == "awaited":
        return MissingText(f"{never}, so equations 1 to 4 give its times", False)
    advice = "check the export of the clock, raise sem.sidecar_timeout_s, or set sem.row_clock to awaited"
    return MissingText(f"{never}, which sem.row_clock requires; {advice}", True)
