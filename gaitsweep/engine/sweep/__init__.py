"""The sweep: the rows of a job, run in lanes on devices and returned block by block.

`sweep` is its main loop, `lane_scheduler` assigns rows to lanes, `engines` chooses the engine, `lane` has the
functions of one trajectory, `xla` runs them by XLA. `boundary_cells` selects the cells of a refined grid.
"""
