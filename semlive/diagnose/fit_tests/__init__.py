"""Tests of an estimate or a named effect against the maps: adequacy, frames that were held out, and something outside the catalogue."""
