"""Stick figures and movies of a row."""
