"""Reports of a run: pages, figures, exports and scores."""
