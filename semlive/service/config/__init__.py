"""The configuration file: read, checked, completed, written."""
