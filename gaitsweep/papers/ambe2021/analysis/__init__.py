"""The multi-legged chain's tables beside its theory."""
