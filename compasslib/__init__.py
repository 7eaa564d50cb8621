"""Correction of compass deviations in moored current records."""

__version__ = "0.1.0"
