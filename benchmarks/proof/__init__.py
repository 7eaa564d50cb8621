"""The sealed proof: moorings whose truth is locked away, run through the ordinary pipeline, then scored.

    python -m benchmarks.proof --seed 7 --count 24

Only this package knows both sides. ``draw`` makes moorings and locks their truth away, ``seal`` keeps hashes, ``run``
starts the pipeline as anyone would, ``measure`` reads what it left, ``score`` judges, ``card`` writes.
"""
