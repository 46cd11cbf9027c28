"""Diagnosis of the intensity channel: effects on the grey levels of frames."""
