"""Correction of compass deviations in moored current records."""

__version__ = "0.2.0"
