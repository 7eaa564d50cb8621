"""Files of the results: whole or not at all, the same bytes for the same data."""
