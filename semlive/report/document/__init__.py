"""A report as a document of sections, independent of its format, and its writers: HTML, PDF, and files of the figures."""
