"""Jobs, in YAML or Python: their fields, checks and rows.

`load` reads a file and applies `--set`. The classes in `job` have the fields, and refuse unknown ones by
`gaitsweep/schema/strict_model.py`. `reading` has the config and the order in which sections are read,
`model_spec` and `numerics` some of these sections, of which the second finds stiff rows; `checks` and
`step_lengths` compare them with each other, and `row_remarks` tries a user's model.
"""

from gaitsweep.errors import JobError
from gaitsweep.job.job import Job, read_figures, schema
from gaitsweep.job.load import load_job
from gaitsweep.schema.diagnostics import Diagnostic

__all__ = ["Diagnostic", "Job", "JobError", "load_job", "read_figures", "schema"]
