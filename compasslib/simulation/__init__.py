"""A simulated sea with moorings in it, which writes the raw files that the instruments would have left.

It is the independent check of the analysis: it shares no code with the rest of compasslib, its angles included, and
derives every reading from the forward physics alone.
"""
