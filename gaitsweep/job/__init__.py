"""Jobs, in YAML or Python: their fields, checks and rows."""

from gaitsweep.job.job import Job, read_figures, schema
from gaitsweep.job.load import load_job
from gaitsweep.schema.diagnostics import Diagnostic, JobError

__all__ = ["Diagnostic", "Job", "JobError", "load_job", "read_figures", "schema"]
