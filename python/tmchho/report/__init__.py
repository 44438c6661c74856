"""The report of a registration, and the view of clouds: pages that need nothing else.

Why: what a surveyor signs is one file that opens in any browser, with the verdict first.
Reads: ``result.json`` and ``report_points.npz``, which a registration leaves.
Absent on purpose: registration and distances; nothing is computed again.
"""

from tmchho.report.folder import write_report
from tmchho.report.template import missing_extras
from tmchho.report.view import write_view

__all__ = ["missing_extras", "write_report", "write_view"]
