"""Measurements: ``python -m bench`` prints all of them. Both sides of a ratio run in turns."""
