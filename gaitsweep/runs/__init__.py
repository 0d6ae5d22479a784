"""Execution of jobs: preparation, runs, self-checks and results.

`prepare` chooses engine and devices, and the hash of the directory; `estimate` predicts time and memory,
`execute` runs a job, `executor` its blocks, here or on a `cluster`, and `job_array` one range of its rows
beside other processes; `progress` is what they report. `refinement` runs the edges of basins only.
`self_check` reruns a sample of the rows by finer steps (its sample, the changes and the result are in
`self_check_result`), looks for `unstable_rests`, and for `repeating_rows` among those that did not settle;
`concurrent_self_check` runs it beside the rows.
`summary` counts rows and `sentences` words their statuses, `provenance` has versions and machine, `citation`
cites it, `figures` draws it, `dataset` has it as an xarray. `model_trial` is the short run of `gaitsweep
check-model`.
"""
