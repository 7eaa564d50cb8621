"""Where a recording and its simulation differ, what physics was left out, and how sure that is.

One door: ``diagnose`` for a mooring; ``case`` and ``search`` are the general core that other recordings use.
"""

from __future__ import annotations

from compasslib.discrepancy.applied import Applied
from compasslib.discrepancy.diagnosis import Options, diagnose, judge
from compasslib.discrepancy.verdict import Diagnosis, Finding, insufficient

__all__ = ["Applied", "Diagnosis", "Finding", "Options", "diagnose", "insufficient", "judge"]
