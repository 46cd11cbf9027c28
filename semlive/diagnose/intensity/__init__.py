"""Effects that grey levels show."""
