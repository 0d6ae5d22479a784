"""A job's blocks computed by the workers of a Dask cluster.

Dask's `distributed` schedules; what is here is the task of a worker (`task`), what a worker has to be
(`identity`), how a cluster is reached (`connection`), and how the blocks of a table are given out, workers
and schedulers being lost meanwhile (`dispatch`).
"""
