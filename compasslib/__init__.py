"""Correction of compass deviations in moored current records."""

__version__ = "1.0.0"
