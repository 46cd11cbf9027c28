"""Quantities derived from the posterior: corrections, uncertainties, forecasts, checks."""
