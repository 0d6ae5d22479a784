"""Figures of the multi-legged chain and its theory."""
