"""A world of its own for the proof: it shares no water, no iron and no effect with the one the search was built on.

``scene`` says what truly was at a mooring; ``seas`` makes it up, ``records`` takes it from real ones. ``families`` is
what may be planted: it was sealed by its hash before the code of the search was frozen. ``compass`` reads a heading
there, ``export`` writes the files. Nothing here imports the search, the effects or the fit.
"""
