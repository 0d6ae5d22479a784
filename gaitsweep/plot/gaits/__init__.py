"""Figures of footfalls, footprints and gaits over speed."""
