"""The sweep: the rows of a job, run in lanes on devices and returned block by block."""
