"""What a user asks for: a job in YAML or Python, checked, and its rows."""

from gaitsweep.job.load import load_job
from gaitsweep.job.plan import Plan
from gaitsweep.job.schema import Job, read_figures, schema
from gaitsweep.kinds.diagnostics import Diagnostic, JobError
from gaitsweep.kinds.run_kind import PlanAxis

__all__ = ["Diagnostic", "Job", "JobError", "Plan", "PlanAxis", "load_job", "read_figures", "schema"]
