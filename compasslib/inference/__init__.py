"""Search for unmodelled effects: where recording and simulation differ, what physics is missing, and how certain it is.

``kinds.mooring.diagnose`` searches a mooring, ``kinds.diagnose`` a calibration's recording; ``joint.join_compass``
joins the records of one compass. Nothing is imported here, because jobs that only correct need no search.

An error on a test bench that the fitted curve cannot represent, here with three cycles per turn:

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
...     diagnosis = kinds.diagnose("platform", [path], {}, options)
>>> diagnosis.verdict, [finding.effect for finding in diagnosis.findings]
('explained', ['sextantal'])

Three deployments in different fields with the same iron, 600 nT forward, known to about 60 nT; the fourth differs:

>>> from compasslib.inference.joint_compass import Member, join_records
>>> fields = {"A": 12000.0, "B": 15000.0, "C": 12000.0, "D": 12000.0}
>>> covariance = np.diag([0.01, 0.005, 0.005, 0.005, 0.005]) ** 2
>>> iron = {"A": 600.0, "B": 560.0, "C": 640.0, "D": -900.0}
>>> members = [
...     Member(name, "mooring", None, h, 50000.0, np.array([0.0, iron[name] / h, 0.0, 0.0, 0.0]), covariance)
...     for name, h in fields.items()
... ]
>>> joined = join_records(members)
>>> joined.consistent, [record.name for record in joined.rejected]
(('A', 'B', 'C'), ['D'])
"""
