"""Read and validate the YAML files of a cruise as immutable models; a mistake is reported in one line.

>>> from compasslib.config import cruise, schema
>>> options = cruise.parse(b"demonstraton: true", "config.yaml")
>>> cruise.validate(schema.CruiseOptions, options, "config.yaml")  # doctest: +ELLIPSIS
Traceback (most recent call last):
compasslib.errors.InputError: config.yaml: demonstraton: expected a key out of ...; write demonstration
"""
