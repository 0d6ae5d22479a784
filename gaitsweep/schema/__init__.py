"""Conversion of text to checked values: documents, numbers, strict models, and diagnostics."""
