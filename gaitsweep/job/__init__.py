"""What a user asks for: a job in YAML or Python, checked, and its rows."""

from gaitsweep.job.load import load_job
from gaitsweep.job.schema import Job, read_figures, schema
from gaitsweep.schema.diagnostics import Diagnostic, JobError

__all__ = ["Diagnostic", "Job", "JobError", "load_job", "read_figures", "schema"]
