"""Jobs, in YAML or Python: their fields, checks and rows.

`load` reads a file and applies `--set`. `job` has the fields of a job, which refuse unknown ones by
`gaitsweep/schema/strict_model.py`. `reading` merges a job with its config and reads the sections in order:
`model_spec` those of the model, `numerics` those of the integration, where it also finds stiff rows.
`checks` and `step_lengths` compare the sections with each other, and `row_remarks` tries a user's model.
"""

from gaitsweep.errors import JobError
from gaitsweep.job.job import Job, read_figures, schema
from gaitsweep.job.load import load_job
from gaitsweep.schema.diagnostics import Diagnostic

__all__ = ["Diagnostic", "Job", "JobError", "load_job", "read_figures", "schema"]
