"""Gaits from swing onsets, loads and tilt."""
