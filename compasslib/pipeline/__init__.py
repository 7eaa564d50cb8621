"""Execution of a stage as a job of Snakemake, and processing of one mooring without Snakemake.

Inputs and outputs stand in the rules (``workflow/rules``). Each setting of a stage is a parameter of its rule:

>>> from compasslib.pipeline.job import flatten, unflatten
>>> flatten({"method": "exact", "place": {"latitude": 66.5}, "exclude": [[0.0, 1.5]]}).values()
dict_values(['method="exact"', 'place.latitude=66.5', 'exclude[0][0]=0.0', 'exclude[0][1]=1.5'])
>>> unflatten(['method="exact"', "place.latitude=66.5", "exclude[0][0]=0.0", "exclude[0][1]=1.5"])
{'method': 'exact', 'place': {'latitude': 66.5}, 'exclude': [[0.0, 1.5]]}
"""
