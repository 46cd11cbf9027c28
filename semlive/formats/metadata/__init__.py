"""Metadata of exported files: headers, quantities with provenance, timestamps, checksums."""
