"""Computation of a job's blocks by the workers of a Dask cluster.

Dask's `distributed` schedules the tasks. This package has the task of a worker and the requirements on it
(`task`), the workers that meet them (`worker_pool`), connections to what `--cluster` names, workers on this
machine included (`connection`), and the dispatch of blocks, which survives the loss of workers and
schedulers (`dispatch`).
"""
