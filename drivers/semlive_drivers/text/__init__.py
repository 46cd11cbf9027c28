"""Devices that speak plain text over a serial line, their dialogue described as data (docs/text-dialogues.md)."""
