"""Functions of `import gaitsweep as gs`, as listed in `gaitsweep/__init__.pyi`."""
