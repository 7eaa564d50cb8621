"""The search of short recordings: benches, logs, swings, two heads."""
