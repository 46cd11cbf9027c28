"""What can go wrong, as one tree.

SemliveError                every error that semlive raises on purpose
+-- BadInput                something the user gave is wrong: says what, where, what to do (exit code 2)
|   +-- BadConfig           the configuration file
|   +-- BadImage            an exported image that cannot be read or believed
|   +-- BadLog              an MCAP log that cannot be read or lacks what is asked of it
+-- LinkError               a device link: refused, timed out, lost, or answering nonsense
|   +-- LinkRefused         nobody answers at the configured address when the run starts (exit code 2)
+-- IllPosed                the data cannot determine what is asked of them, and why
    +-- PoorCalibration     nothing under load is corrected with it (exit code 2)
"""

from __future__ import annotations


class SemliveError(Exception):
    """Base of all errors that semlive raises on purpose; the message is one sentence for the operator."""


class BadInput(SemliveError):
    """Something the user gave is wrong; the message says what, where and what to do."""


class BadConfig(BadInput):
    """The configuration file is missing, malformed or contradicts itself."""


class BadImage(BadInput):
    """An exported image cannot be read, or must not be believed."""


class BadLog(BadInput):
    """A log cannot be read, or lacks what is asked of it."""


class LinkError(SemliveError):
    """A device link is lost, too slow, or answers nonsense."""


class LinkRefused(LinkError, BadInput):
    """Nobody answers at the configured address when the run starts."""


class IllPosed(SemliveError):
    """The data cannot determine what is asked of them; the message says what is missing."""


class PoorCalibration(IllPosed, BadInput):
    """The translations went in one direction only, or were too small; the message holds the figures that show it."""
