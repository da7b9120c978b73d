"""Measurements: ``python -m bench`` prints them all. Ratios are taken side by side in one run."""
