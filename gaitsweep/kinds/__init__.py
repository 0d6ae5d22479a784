"""Kinds of runs: what a job may do with each of its rows."""
