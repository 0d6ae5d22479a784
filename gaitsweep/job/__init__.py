"""Jobs, in YAML or Python: their fields, checks and rows.

`load` reads a file and applies `--set`. `job` has the fields of a job, which refuse unknown ones by
`gaitsweep/schema/strict_model.py`, and its hash. `reading` merges a job with its config and reads the
sections in order: `model_spec` those of the model, `numerics` those of the integration, where it also finds
stiff rows. `checks` compares the sections with each other, also values with the bounds of their parameters;
`step_lengths` has the step of each row (by `gaitsweep/engine/numerics.py`) and refuses a `numerics.dt` that
is too long, and `row_remarks` tries a user's model.
"""

from gaitsweep.errors import JobError
from gaitsweep.job.job import Job, read_figures, schema
from gaitsweep.job.load import load_job
from gaitsweep.schema.diagnostics import Diagnostic

__all__ = ["Diagnostic", "Job", "JobError", "load_job", "read_figures", "schema"]
