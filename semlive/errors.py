"""The error classes of semlive, as a tree.

SemliveError                every error that semlive raises on purpose
+-- BadInput                invalid input of the user; the message states what, where, what to do (exit code 2)
|   +-- BadConfig           the configuration file
|   +-- BadImage            an exported image that cannot be read or trusted
|   +-- BadLog              an MCAP log that cannot be read or lacks required messages
+-- LinkError               a device link: refused, timed out, lost, or with invalid replies
|   +-- LinkRefused         no device replies at the configured address when the run starts (exit code 2)
+-- IllPosed                the data do not determine the requested quantity; the message states why
    +-- PoorCalibration     the distortion is not determined well enough to correct frames under load (exit code 2)
"""

from __future__ import annotations


class SemliveError(Exception):
    """Base of all errors that semlive raises on purpose; the message is a single line for the operator."""


class BadInput(SemliveError):
    """Invalid input of the user; the message states what, where and what to do."""


class BadConfig(BadInput):
    """The configuration file is missing, malformed or contradicts itself."""


class BadImage(BadInput):
    """An exported image cannot be read, or must not be trusted."""


class BadLog(BadInput):
    """A log cannot be read, or lacks required messages."""


class LinkError(SemliveError):
    """A device link is lost or too slow, or its replies are invalid."""


class LinkRefused(LinkError, BadInput):
    """No device replies at the configured address when the run starts."""


class IllPosed(SemliveError):
    """The data do not determine the requested quantity; the message states what is missing."""


class PoorCalibration(IllPosed, BadInput):
    """The translations went in one direction only, or were too small; the message holds the figures that show it."""
