"""Computation of a job's blocks by the workers of a Dask cluster.

Dask's `distributed` schedules the tasks. This package has the task of a worker (`task`), the requirements
on a worker (`identity`), connections to a cluster (`connection`), and the dispatch of blocks, which survives
the loss of workers and schedulers (`dispatch`).
"""
