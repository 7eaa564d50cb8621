"""Figures for a paper, each one PNG: the deviation, the agreement before and after, the record along time, the theory.

Figures 5 to 9 of von Appen 2015 and a timeline. This room alone (the modules that begin with ``plots``) knows
matplotlib. A figure appears whole or not at all, and the same data give the same bytes.
"""

from __future__ import annotations

from compasslib.plots_agreement import histograms, scatter
from compasslib.plots_deviation import deviation, theory
from compasslib.plots_diagnosis import diagnosis
from compasslib.plots_timeline import timeline

__all__ = ["deviation", "diagnosis", "histograms", "scatter", "theory", "timeline"]
