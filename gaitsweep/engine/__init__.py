"""How rows are run, knowing no model."""
