"""Jobs carried out: prepared, run, checked, and their results."""
