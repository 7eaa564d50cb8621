"""Several records of one compass: what they tell together, which of them does not belong, what each learns from it.

Three deployments in other fields of the same iron, 600 nT forward, each known to some 60 nT; the fourth is another:

>>> import numpy as np
>>> from compasslib.joint import coefficients
>>> from compasslib.joint.members import Member
>>> fields = {"A": 12000.0, "B": 15000.0, "C": 12000.0, "D": 12000.0}
>>> sure = np.diag([0.01, 0.005, 0.005, 0.005, 0.005]) ** 2
>>> iron = {"A": 600.0, "B": 560.0, "C": 640.0, "D": -900.0}
>>> members = [
...     Member(name, "mooring", None, field, 50000.0, np.array([0.0, iron[name] / field, 0.0, 0.0, 0.0]), sure)
...     for name, field in fields.items()
... ]
>>> joined = coefficients.join(members)
>>> joined.kept, [rejected.name for rejected in joined.rejected]
(('A', 'B', 'C'), ['D'])
"""
