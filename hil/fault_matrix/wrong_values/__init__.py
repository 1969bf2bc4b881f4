"""The campaign of wrong values: a bench file with one wrong number, and hardware that has the true one.

For each plausible mistake in each parameter `hil doctor`, a quick `bring_up` and a short climb are run, and
the emulated world says what was true. A mistake may be right (named), misnamed, harmless, unconfirmed or
silent.
"""

from hil.fault_matrix.wrong_values.cases import WrongValue, cases_of
from hil.fault_matrix.wrong_values.judge import Verdict, judged, lost
from hil.fault_matrix.wrong_values.observed import observe
from hil.fault_matrix.wrong_values.table import summary, write_pages

__all__ = ["Verdict", "WrongValue", "cases_of", "judged", "lost", "observe", "summary", "write_pages"]
