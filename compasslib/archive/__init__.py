"""Input and output of result files: complete or not at all, and the same bytes for the same data.

If writing fails, an earlier file remains unchanged:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib.archive import files
>>> with TemporaryDirectory() as folder:
...     path = Path(folder, "fit.json")
...     files.write_json(path, {"B": 0.1 + 0.2})
...     try:
...         with files.atomic_write(path) as half_written:
...             _ = half_written.write_text("{")
...             raise KeyboardInterrupt
...     except KeyboardInterrupt:
...         files.read_json(path), len(list(Path(folder).iterdir()))
({'B': 0.3}, 1)
"""
