"""Which files are accepted at once, because their bytes prove that they are complete; all others must be constant for `stable_for_s`.

The bytes prove that an image is complete, but not that no text follows. Therefore no file is accepted at once after one with a text file.
A file without the header of a vendor inside it is accepted at once only if the first file, which was awaited, had neither header nor text.
"""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats import CompletenessProof, prove_complete

_HEADERS_IN_IMAGE = frozenset({"fei", "zeiss", "tescan"})
_NO_HEADER = "plain"


@dataclass(slots=True)
class ByteProofs:
    """Evaluates proofs of completeness; it learns from the files that were awaited.

    Attributes:
        profile: number of databar rows for files that do not contain it.
    """

    profile: ScanProfile
    _vendors: frozenset[str] | None = None
    _newest: CompletenessProof | None = None

    def accepts(self, file: ExportedFile) -> bool:
        """Whether a file without text file can be accepted at once; if so, it counts as the newest file.

        A row of the newest file in it is evidence of an old file that is being overwritten in place.
        """
        proof, vendors = self._proof(file), _HEADERS_IN_IMAGE if self._vendors is None else self._vendors
        if proof is None or proof.vendor not in vendors or (self._newest is not None and proof.shares_rows(self._newest)):
            return False
        self._remember(proof)
        return True

    def awaited(self, file: ExportedFile) -> None:
        """Learn from a file that was accepted after it had been constant for some time."""
        proof = self._proof(file)
        if file.sidecar is not None:
            self.await_texts()
        elif proof is not None:
            self._remember(proof)

    def await_texts(self) -> None:
        """Accept no file at once any more, because these files have text files."""
        self._vendors = frozenset()

    def _remember(self, proof: CompletenessProof) -> None:
        """Restrict files that are accepted at once to those like the first: all with a header, or all without."""
        if self._vendors is None:
            self._vendors = frozenset({_NO_HEADER}) if proof.vendor == _NO_HEADER else _HEADERS_IN_IMAGE
        self._newest = proof

    def _proof(self, file: ExportedFile) -> CompletenessProof | None:
        try:
            return None if file.sidecar is not None else prove_complete(file, self.profile)
        except BadImage:
            return None
