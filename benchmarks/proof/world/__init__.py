"""Independent simulation for the proof: nothing here imports the search, the effects or the fit of the library.

``families`` defines the effects, sealed by its hash before the code of the search was frozen.
"""
