"""What is computed from tables and models: gaits, and the theory behind them."""
