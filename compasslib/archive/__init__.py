"""Input and output of result files: complete or not at all, and the same bytes for the same data.

>>> from tempfile import TemporaryDirectory
>>> from compasslib.archive import files
>>> with TemporaryDirectory() as folder:
...     files.write_json(f"{folder}/fit.json", {"B": 0.1 + 0.2})
...     files.read_json(f"{folder}/fit.json")
{'B': 0.3}
"""
