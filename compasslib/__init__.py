"""Correction of compass deviations in moored current records.

Iron with B = 0.3 turns the reading at 90 degrees by 17; the inverse in closed form gives the correct heading again:

>>> import numpy as np
>>> from compasslib import angles, compass, earthfield
>>> iron = np.array([0.0, 0.3, 0.0, 0.0, 0.0])  # A, B, C, D, E of the exact compass
>>> float(compass.recorded_heading(iron, 90.0).round(1))
73.3
>>> float(compass.inverse(iron, np.array([73.3]))[0, 0].round(1))
90.0
>>> angles.mean([350.0, 20.0]).round(6).tolist()
5.0
>>> declination, horizontal, vertical = earthfield.igrf(66.5, 0.4, [1188864000.0])  # September 2007
>>> round(float(declination[0]), 1), round(float(horizontal[0]))
(-4.5, 12314)
"""

__version__ = "1.0.0"
