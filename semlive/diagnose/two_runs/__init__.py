"""Effects that two runs separate and one cannot."""
