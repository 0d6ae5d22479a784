"""Rivals on their own tasks: each library's published example, or its strong point, beside gaitsweep."""
