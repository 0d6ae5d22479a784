"""The functions of `import gaitsweep as gs`; `gaitsweep/__init__.py` lists them."""
