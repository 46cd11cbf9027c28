"""Archives of a run by public validators: NXem by pynxtools, RO-Crate by roc-validator.

    python -m venv CHECK && CHECK/bin/pip install "pynxtools>=0.16,<1" "roc-validator>=0.13,<1"
    python tests/benchmarks/validate_archive.py LOG --programs CHECK/bin [--describe deposit.yaml] [--keep FOLDER] [--context FILE]

The log is exported with `semlive export --format ro-crate`, whose folder contains the NeXus file. Exit code 1: a validator rejects it.
roc-validator loads the JSON-LD context of RO-Crate from the network. Without network, `--context` gives the file: it is
`docs/_specification/1.1/context.jsonld` of https://github.com/ResearchObject/ro-crate. It becomes the only entry of the
validator's own HTTP cache, which then runs with `--offline`; its rules stay as they are.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

NEEDLESS = re.compile(r"^(The unit .* has no documentation\.|DeprecationWarning.*|\s*)$")
"""Lines of pynxtools about units of fields that the definition does not fix (NXdata, NXcollection), which are no finding."""


CONTEXT_ADDRESS = "https://w3id.org/ro/crate/1.1/context"
"""Address of the context in the crate."""
STORE_CONTEXT = """
import sys
from requests import Request
from requests_cache import CachedRequest, CachedResponse, CachedSession
cache, address, file = sys.argv[1:]
request = CachedRequest.from_request(Request("GET", address).prepare())
content = open(file, "rb").read()
answer = CachedResponse(status_code=200, url=address, request=request, content=content)
answer.headers["Content-Type"] = "application/ld+json"
CachedSession(cache_name=cache, backend="sqlite", expire_after=-1).cache.save_response(answer)
"""
"""Program for the Python of the validators: stores a file as the answer of an address in an HTTP cache of roc-validator."""


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


def cached_context(programs: Path, context: Path, place: Path) -> list[str]:
    """Store the JSON-LD context in a new HTTP cache of roc-validator; returns the options that use it."""
    cache = place / "http_cache"
    store = [str(programs / "python"), "-c", STORE_CONTEXT, str(cache), CONTEXT_ADDRESS, str(context)]
    subprocess.run(store, check=True)
    return ["--offline", "--cache-path", str(cache)]


def crate_findings(programs: Path, folder: Path, severity: str, offline: list[str]) -> tuple[bool, list[str]]:
    """Validate an RO-Crate against the profile that it names and those below it: whether it is valid, and the findings."""
    command = [str(programs / "rocrate-validator"), "-y", "--disable-color", "validate", str(folder), "-l", severity, "-f", "json"]
    with tempfile.TemporaryDirectory() as place:
        report = Path(place) / "report.json"
        done = subprocess.run([*command, "-o", str(report), *offline], capture_output=True, text=True)
        if not report.is_file():
            return False, (done.stdout + done.stderr).splitlines()
        found = json.loads(report.read_text(encoding="utf-8"))
    issues = [f"{issue['severity']}: {issue['message']}" for issue in found["issues"]]
    return bool(found["passed"]), issues


def main() -> int:
    """Export, validate and print the findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--programs", type=Path, required=True, help="folder with pynx and rocrate-validator")
    parser.add_argument("--describe", type=Path)
    parser.add_argument("--context", type=Path, help="file of the JSON-LD context of RO-Crate 1.1, for a computer without network")
    parser.add_argument("--keep", type=Path, help="folder of the crate; by default a temporary one")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        crate = exported(given.log, given.keep or Path(folder) / "crate", given.describe)
        valid, lines = nexus_findings(given.programs, crate / "fields.nxs")
        counted = Counter(re.sub(r"event_\d+", "event_N", line.replace(str(crate), "")) for line in lines)
        sys.stdout.write(f"NXem by pynxtools: {'valid' if valid else 'NOT valid'}\n")
        sys.stdout.writelines(f"  {count:4d} x {line}\n" for line, count in counted.most_common())
        accepted = [valid]
        offline = [] if given.context is None else cached_context(given.programs, given.context, Path(folder))
        for severity in ("required", "recommended"):
            passed, issues = crate_findings(given.programs, crate, severity, offline)
            sys.stdout.write(f"RO-Crate and Process Run Crate by roc-validator, {severity}: {'passed' if passed else 'NOT passed'}\n")
            sys.stdout.writelines(f"  {issue}\n" for issue in issues)
            if severity == "required":
                accepted.append(passed)
    return 0 if all(accepted) else 1


if __name__ == "__main__":
    sys.exit(main())
