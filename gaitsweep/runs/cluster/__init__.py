"""Computation of a job's blocks by the workers of a Dask cluster.

Dask's `distributed` schedules the tasks. This package has the task of a worker (`task`), the requirements
on a worker (`identity`), the workers that meet them (`worker_pool`), workers on this machine
(`local_workers`), connections to other clusters (`connection`), what `--cluster` names (`cluster_option`),
and the dispatch of blocks, which survives the loss of workers and schedulers (`dispatch`).
"""
