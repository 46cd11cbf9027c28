"""Diagnosis: test the model against the data, identify the missing effect, add it, and verify that the misfit decreases."""
