"""A sweep: rows through lanes on devices, block by block."""
