"""File formats of microscopes, one module per vendor, and the timing of their files in the export folder."""
