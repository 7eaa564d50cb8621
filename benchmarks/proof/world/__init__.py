"""Independent simulation for the proof: it shares no currents, iron or effects with that used to develop the search.

``scene`` describes the truth at a mooring; ``seas`` simulates it, ``records`` takes it from real records. ``families``
defines the effects, sealed by its hash before the code of the search was frozen. ``compass`` simulates readings, and
``export`` writes the files. Nothing here imports the search, the effects or the fit of the library.
"""
