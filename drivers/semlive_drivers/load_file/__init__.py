"""Load frames whose readings are lines that a program appends to a text file."""
