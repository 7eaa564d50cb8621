"""Figures for a paper, each one PNG; this room alone knows matplotlib.

Figures 5 to 9 of von Appen 2015, the record along time, the diagnosis, and those of calibrations. A figure appears
whole or not at all, and the same data give the same bytes.
"""
