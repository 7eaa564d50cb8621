"""Where a recording and its simulation differ, what physics was left out, and how sure that is.

``diagnosis.diagnose`` searches a mooring, ``kinds.diagnose`` a calibration's recording. Nothing is imported here: the
jobs that only correct need no search.

What a bench shows that its curve does not hold, here three cycles a turn:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> import numpy as np
>>> from compasslib.angles import sin_cos
>>> from compasslib.inference import kinds
>>> turned = np.arange(0.0, 360.0, 5.0)
>>> read = turned - 4.0 * sin_cos(turned)[0] - 3.0 * sin_cos(3.0 * turned)[0]
>>> rows = [f"{heading},{recorded:.1f}" for heading, recorded in zip(turned, read)]
>>> options = kinds.chosen({"enabled": True, "min_effect_deg": 0.5, "apply": False})
>>> with TemporaryDirectory() as folder:
...     path = Path(folder, "bench.csv")
...     _ = path.write_text("\\n".join(["reference_deg,recorded_deg", *rows, ""]))
...     found = kinds.diagnose("platform", [path], {}, options)
>>> found.verdict, [one.effect for one in found.findings]
('explained', ['sextantal'])
"""
