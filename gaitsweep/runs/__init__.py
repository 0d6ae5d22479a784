"""Execution of jobs: preparation, runs, self-checks and results."""
