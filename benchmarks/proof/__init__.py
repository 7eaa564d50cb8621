"""The sealed proof: moorings whose truth is locked away, run through the ordinary pipeline, then scored.

    python -m benchmarks.proof --commit             the seed of this commit, and how it comes about
    python -m benchmarks.proof --count 300 --real 150
    python -m benchmarks.proof --card               of which engine the cards of record are

``world`` alone knows what is planted and ``score`` what is said of it: the first makes moorings and locks their truth
away, ``seal`` keeps hashes, ``run`` starts the pipeline, ``measure`` reads what it left, ``score`` judges, ``tally``
counts, ``card`` writes. A run that was cut goes on where it was.
"""
