"""Execution of a stage as a job of Snakemake, and processing of one mooring without Snakemake."""
