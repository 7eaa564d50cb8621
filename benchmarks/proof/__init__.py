"""Sealed proof: moorings with sealed truth, processed by the ordinary pipeline and then scored.

    python -m benchmarks.proof --commit             the seed of this commit, and its derivation
    python -m benchmarks.proof --count 300 --real 150
    python -m benchmarks.proof --card               the engine of each published scorecard

Only ``world`` knows the planted effects: it simulates moorings and stores their truth separately. ``seal`` computes
hashes, ``run`` starts the pipeline, ``measure`` reads its results, ``score`` compares them with the truth, ``tally``
computes rates, and ``card`` writes the scorecard. An interrupted run resumes where it stopped.
"""
