"""Diagnosis of scalar readings: load cell, strain gage and stage."""
