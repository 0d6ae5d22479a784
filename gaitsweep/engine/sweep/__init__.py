"""The sweep: the rows of a job, run in lanes on devices and returned block by block.

`sweep` is its main loop, which writes blocks, `lane_scheduler` assigns rows to lanes (`lane_group`),
`engine_choice` chooses kernel or XLA and the number of lanes (devices: `engine/devices.py`, precision:
`engine/numerics.py`), `lane` has the functions of one trajectory, `xla` runs them by XLA. `blocks_of_rows`
splits a table into blocks, which bound its memory, and asks the model for gaits. `boundary_cells` selects
the cells of a refined grid, `sweep_spec` is what a sweep needs to know.
"""
