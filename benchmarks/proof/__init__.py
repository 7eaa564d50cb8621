"""Sealed proof: moorings with sealed truth, processed by the ordinary pipeline and then scored.

Only ``world`` knows the planted effects: it simulates moorings and stores their truth separately. An interrupted run
resumes where it stopped.
"""
