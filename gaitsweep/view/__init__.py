"""Pages and movies of a result directory: explorer, report, animations."""
