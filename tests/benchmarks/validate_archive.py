"""Archives of a run by public validators: NXem by pynxtools, RO-Crate by roc-validator.

    python -m venv CHECK && CHECK/bin/pip install "pynxtools>=0.16,<1" "roc-validator>=0.13,<1"
    python tests/benchmarks/validate_archive.py LOG --programs CHECK/bin [--describe deposit.yaml] [--keep FOLDER]

The log is exported with `semlive export --format ro-crate`, whose folder contains the NeXus file. Exit code 1: a validator rejects it.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

NEEDLESS = re.compile(r"^(The unit .* has no documentation\.|DeprecationWarning.*|\s*)$")
"""Lines of pynxtools about units of fields that the definition leaves open (NXdata, NXcollection), which are no finding."""


def exported(log: Path, out: Path, describe: Path | None) -> Path:
    """Export the log as RO-Crate; returns its folder."""
    command = [sys.executable, "-m", "semlive", "export", str(log), "--format", "ro-crate", "-o", str(out)]
    subprocess.run(command if describe is None else [*command, "--describe", str(describe)], check=True)
    return out


def nexus_findings(programs: Path, file: Path) -> tuple[bool, list[str]]:
    """Validate a NeXus file: whether it is valid, and the findings without the needless lines."""
    done = subprocess.run([programs / "pynx", "validate", str(file)], capture_output=True, text=True)
    lines = [line for line in (done.stdout + done.stderr).splitlines() if not NEEDLESS.match(line)]
    return any("is valid according to the `NXem`" in line for line in lines), lines


def crate_findings(programs: Path, folder: Path, profile: str, severity: str) -> tuple[bool, str]:
    """Validate an RO-Crate against a profile: whether it is valid, and the output."""
    command = [programs / "rocrate-validator", "-y", "--disable-color", "validate", str(folder), "-p", profile, "-l", severity]
    done = subprocess.run([*map(str, command), "--no-paging", "-v"], capture_output=True, text=True)
    return done.returncode == 0, done.stdout + done.stderr


def main() -> int:
    """Export, validate and print the findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--programs", type=Path, required=True, help="folder with pynx and rocrate-validator")
    parser.add_argument("--describe", type=Path)
    parser.add_argument("--keep", type=Path, help="folder of the crate; by default a temporary one")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        crate = exported(given.log, given.keep or Path(folder) / "crate", given.describe)
        valid, lines = nexus_findings(given.programs, crate / "fields.nxs")
        counted = Counter(re.sub(r"event_\d+", "event_N", line.replace(str(crate), "")) for line in lines)
        sys.stdout.write(f"NXem by pynxtools: {'valid' if valid else 'NOT valid'}\n")
        sys.stdout.writelines(f"  {count:4d} x {line}\n" for line, count in counted.most_common())
        accepted = [valid]
        for profile in ("ro-crate-1.1", "process-run-crate-0.5"):
            for severity in ("required", "recommended"):
                passed, output = crate_findings(given.programs, crate, profile, severity)
                sys.stdout.write(f"{profile}, {severity}: {'passed' if passed else 'NOT passed'}\n{'' if passed else output}")
                if severity == "required":
                    accepted.append(passed)
    return 0 if all(accepted) else 1


if __name__ == "__main__":
    sys.exit(main())
