"""Jobs, in YAML or Python: their fields, checks and rows."""

from gaitsweep.job.load import load_job
from gaitsweep.job.plan import Plan
from gaitsweep.job.schema import Job, read_figures, schema
from gaitsweep.kinds.diagnostics import Diagnostic, JobError
from gaitsweep.kinds.run_kind import PlanAxis

__all__ = ["Diagnostic", "Job", "JobError", "Plan", "PlanAxis", "load_job", "read_figures", "schema"]
