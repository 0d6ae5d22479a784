"""Independent references for the models, in plain NumPy and SciPy; nothing here imports gaitsweep."""
