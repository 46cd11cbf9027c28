"""Files that may still be written to, and the decision when they are stable."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from semlive.ports import ClockSource
from semlive.service.watch.folder_listing import FolderListing, Key, Sidecar, is_same_file, is_same_sidecar
from semlive.service.watch.watch_settings import WatchSettings


@dataclass(slots=True)
class Candidate:
    """A file that may still be written to. Times are monotonic, ns, except `settled_time_ns`.

    Attributes:
        key: size, times and file id at the last scan.
        since_ns: start of the interval without changes of the file or its sidecar.
        settled_time_ns: experiment time of the first scan that found the file in this state; 0 if unknown.
        sidecar: its text file.
        polls: number of scans without changes.
        next_try_ns: earliest time of the next attempt to read it.
        missing_since_ns: time since which scans do not find it; None while they find it.
        held_since_ns: time since which another program has it open; None before.
        hold_is_reported: the operator was informed about the open file.
        reading_since_ns: start of a read that is not finished; None without one.
        is_examined: its bytes in this state do not prove that it is complete, so only time can.
    """

    key: Key
    since_ns: int
    settled_time_ns: int
    sidecar: Sidecar | None = None
    polls: int = 0
    next_try_ns: int = 0
    missing_since_ns: int | None = None
    held_since_ns: int | None = None
    hold_is_reported: bool = False
    reading_since_ns: int | None = None
    is_examined: bool = False

    def restart(self, now_ns: int) -> None:
        """Begin a new interval without changes."""
        self.since_ns, self.polls, self.is_examined = now_ns, 0, False


@dataclass(slots=True)
class Candidates:
    """All files that may still be written to, by name.

    Attributes:
        settings: criteria for a stable file.
        clock: experiment time.
        listing: finds the sidecars.
        reject: rejects a file by name, key and reason.
    """

    settings: WatchSettings
    clock: ClockSource
    listing: FolderListing
    reject: Callable[[str, Key, str], None]
    _candidates: dict[str, Candidate] = field(default_factory=dict)
    _rejected: dict[str, tuple[Key, Sidecar | None]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Candidate:
        return self._candidates[name]

    def __contains__(self, name: str) -> bool:
        return name in self._candidates

    def restart(self, now_ns: int) -> None:
        """Begin new intervals without changes, because nothing is known of the time while the folder was unavailable."""
        for candidate in self._candidates.values():
            candidate.restart(now_ns)

    def clear(self) -> None:
        """Discard all candidates."""
        self._candidates.clear()

    def remove(self, name: str) -> None:
        """Discard a candidate that was accepted."""
        del self._candidates[name]

    def give_up(self, name: str, candidate: Candidate, reason: str) -> None:
        """Reject a candidate until the file or its sidecar changes."""
        del self._candidates[name]
        self._rejected[name] = candidate.key, candidate.sidecar
        self.reject(name, candidate.key, reason)

    def retry_later(self, name: str, candidate: Candidate, now_ns: int, problem: str) -> None:
        """Schedule the next attempt to read an incomplete file, or reject it after `give_up_after_s`.

        Args:
            name: file name.
            candidate: the file.
            now_ns: monotonic time.
            problem: why it is not complete, a clause.
        """
        waited_ns = now_ns - candidate.since_ns
        if waited_ns >= self.settings.give_up_after_s * 1e9:
            self.give_up(name, candidate, f"{problem}; check the export and the permissions, then export again")
        else:
            # A large incomplete file is not read again at every scan.
            candidate.next_try_ns = now_ns + waited_ns // 4

    def forget_vanished(self, listed: dict[str, Key], now_ns: int) -> None:
        """Handle candidates that a scan did not find: renamed, listed late, or deleted."""
        vanished = [name for name in self._candidates if name not in listed]
        new_keys = {key for name, key in listed.items() if name not in self._candidates} if vanished else set[Key]()
        for name in vanished:
            candidate = self._candidates[name]
            if any(is_same_file(candidate.key, key) for key in new_keys):
                del self._candidates[name]  # renamed; its file id is no evidence, because a new file may get that of a deleted one
            elif candidate.missing_since_ns is None:
                candidate.missing_since_ns = now_ns  # a share that was unavailable may list its files late
            elif now_ns - candidate.missing_since_ns >= self.settings.stable_for_s * 1e9:
                del self._candidates[name]
                self.reject(name, candidate.key, "disappeared before it was complete; export into a folder that nobody clears")

    def observe(self, name: str, key: Key, now_ns: int, is_timely: bool) -> bool:
        """Update the candidate of a file that a scan has found.

        Args:
            name: file name.
            key: its size, times and file id.
            now_ns: monotonic time of the scan.
            is_timely: the previous scan was recent, so the arrival time of a new file is known.

        Returns:
            Whether the file or its text file is new or has changed.
        """
        sidecar = self.listing.sidecar(name)
        rejected = self._rejected.get(name)
        if rejected is not None and is_same_file(rejected[0], key) and is_same_sidecar(rejected[1], sidecar):
            return False
        candidate = self._candidates.get(name)
        if candidate is None or candidate.key[:3] != key[:3] or candidate.missing_since_ns is not None:
            self._rejected.pop(name, None)
            self._candidates[name] = Candidate(key, now_ns, self.clock.now_ns() if is_timely else 0, sidecar)
        elif not is_same_sidecar(candidate.sidecar, sidecar, compared=3):
            # The arrival of the image is used for clock offsets, the newer of the two for completeness.
            candidate.sidecar, candidate.next_try_ns = sidecar, 0
            candidate.restart(now_ns)
        else:
            candidate.polls += 1
            return False
        return True

    def stable(self, now_ns: int) -> list[str]:
        """Return the names of the files to read now, in order of modification time."""
        names = [name for name, candidate in self._candidates.items() if self._is_stable(candidate, now_ns)]
        return sorted(names, key=self._order)

    def provable(self, now_ns: int) -> Iterator[str]:
        """Yield the names of the files that are complete now if their bytes prove it, in order of modification time.

        A file that must still be awaited ends the iteration, so that files are accepted in their order.
        """
        for name in sorted(self._candidates, key=self._order):
            candidate = self._candidates[name]
            is_constant = candidate.polls >= 1 and candidate.missing_since_ns is None
            if candidate.is_examined or not is_constant or now_ns - candidate.since_ns < self.settings.proof_after_s * 1e9:
                return
            candidate.is_examined = True
            yield name
            if name in self._candidates:
                return

    def next_due_ns(self, now_ns: int) -> int | None:
        """Return the next time at which a file may be complete if it does not change, or None."""
        s, due_ns = self.settings, list[int]()
        for candidate in self._candidates.values():
            due_ns += [candidate.since_ns + round(wait_s * 1e9) for wait_s in (s.proof_after_s, s.stable_for_s)] + [candidate.next_try_ns]
        return min((time_ns for time_ns in due_ns if time_ns > now_ns), default=None)

    def _order(self, name: str) -> tuple[int, str]:
        return self._candidates[name].key[1], name

    def _is_stable(self, candidate: Candidate, now_ns: int) -> bool:
        long_enough = now_ns - candidate.since_ns >= self.settings.stable_for_s * 1e9
        constant = candidate.polls >= self.settings.stable_polls and candidate.missing_since_ns is None
        return long_enough and constant and now_ns >= candidate.next_try_ns
