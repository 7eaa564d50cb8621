"""A cruise's YAML files in, frozen models out.

A mistake is one line that says where, what was expected, what was found and, at its end, what to do:

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
