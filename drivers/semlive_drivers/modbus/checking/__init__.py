"""Check of a device against its register map: what it answers, and which description explains the answers. Nothing is written."""
