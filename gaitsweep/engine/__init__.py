"""The engine: integration, events, recorders and sweeps, for every model."""
