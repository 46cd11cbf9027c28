"""Maps and pairs of a run that memory does not hold."""
