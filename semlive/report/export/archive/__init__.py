"""Formats that archive a run: NeXus and RO-Crate, with provenance and the description of a deposit."""
