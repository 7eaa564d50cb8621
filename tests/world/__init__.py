"""Simulated recordings of tests and benchmarks: pairs, swings, lowered packages, observatories, sealed cruises."""
