"""Analyses of tables and models: gaits, and the theory behind them."""
