"""Read and validate the YAML files of a cruise as immutable models.

A mistake is reported in one line with its location, what was expected, what was found, and advice:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib.config import cruise
>>> from compasslib.errors import InputError
>>> with TemporaryDirectory() as folder:
...     Path(folder, "config").mkdir()
...     _ = Path(folder, "config/config.yaml").write_text("moorings: []\\ndemonstraton: true\\n")
...     try:
...         cruise.load_cruise(Path(folder))
...     except InputError as error:
...         print(str(error).split('; ')[1])
write demonstration
"""
