"""Devices that speak plain text over a serial line, their dialogue described as data (docs/reference/text-dialogues.md)."""
