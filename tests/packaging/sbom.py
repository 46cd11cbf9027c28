"""Software bill of materials (CycloneDX 1.6) of the wheel; PEP 770 stores it in the wheel's metadata.

    python tests/packaging/sbom.py      # writes deploy/semlive.cdx.json

It lists what the wheel contains of others, with hashes, and the declared dependencies with their version ranges. It depends on the
repository only, so the same commit gives the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
import uuid
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SBOM = ROOT / "deploy" / "semlive.cdx.json"
VENDORED = ROOT / "semlive" / "web" / "static" / "vendor"
NAMESPACE = uuid.UUID("1f6cf7a2-54a2-5d7e-9a3c-6f4f7d9f2b10")


def bill() -> dict[str, Any]:
    """The bill as a JSON object."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    semlive = {
        "type": "application",
        "bom-ref": "semlive",
        "name": "semlive",
        "version": project["version"],
        "licenses": [{"expression": project["license"]}],
        "purl": f"pkg:pypi/semlive@{project['version']}",
    }
    components = [vendored_uplot(), vendored_lean_qr(), *(required(line) for line in project["dependencies"])]
    body = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": semlive},
        "components": components,
        "dependencies": [{"ref": "semlive", "dependsOn": [component["bom-ref"] for component in components]}],
    }
    return {**body, "serialNumber": f"urn:uuid:{uuid.uuid5(NAMESPACE, json.dumps(body, sort_keys=True))}"}


def vendored_uplot() -> dict[str, Any]:
    """uPlot, whose files the wheel contains unchanged."""
    version = re.search(rb"uPlot \(v([\d.]+)\)", (VENDORED / "uPlot.iife.min.js").read_bytes())
    assert version is not None
    return vendored("uplot", version[1].decode(), "*.min.*")


def vendored_lean_qr() -> dict[str, Any]:
    """lean-qr, whose module the wheel contains unchanged; the module does not contain its version."""
    return vendored("lean-qr", (VENDORED / "lean-qr.version.txt").read_text("utf-8").strip(), "lean-qr.mjs")


def vendored(name: str, number: str, pattern: str) -> dict[str, Any]:
    """A package of npm with the hashes of its files."""
    files = [
        {"type": "file", "name": path.name, "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(path.read_bytes()).hexdigest()}]}
        for path in sorted(VENDORED.glob(pattern))
    ]
    return {
        "type": "library",
        "bom-ref": name,
        "name": name,
        "version": number,
        "licenses": [{"license": {"id": "MIT"}}],
        "purl": f"pkg:npm/{name}@{number}",
        "scope": "required",
        "components": files,
    }


def required(line: str) -> dict[str, Any]:
    """A declared dependency; installers choose its version within the range."""
    requirement, _, marker = (part.strip() for part in line.partition(";"))
    name = re.match(r"([A-Za-z0-9._-]+)(?:\[([A-Za-z0-9,._-]+)\])?", requirement)
    assert name is not None
    properties = [{"name": "semlive:version-range", "value": requirement[name.end() :]}]
    if name[2]:
        properties.append({"name": "semlive:extras", "value": name[2]})
    if marker:
        properties.append({"name": "semlive:marker", "value": marker})
    purl = f"pkg:pypi/{re.sub(r'[-_.]+', '-', name[1]).lower()}"
    return {"type": "library", "bom-ref": name[1], "name": name[1], "purl": purl, "scope": "required", "properties": properties}


def text() -> str:
    """The bill as it is stored."""
    return json.dumps(bill(), indent=1) + "\n"


if __name__ == "__main__":
    SBOM.write_text(text(), encoding="utf-8")
