"""Conversion of text to checked values: documents, numbers, strict models, and diagnostics.

`yaml_document` reads a file with the line of each field, `numbers` has the validators of scalars,
`strict_model` classes with fields, their registries and the diagnostics of their errors, `diagnostics` the
error messages (with the nearest name by `gaitsweep/near_miss.py`). The JSON schema of job files, for
editors, is made by `schema` in `gaitsweep/job/job.py`.
"""
