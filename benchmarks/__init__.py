"""Measure speed and accuracy: `python -m benchmarks [NAME ...]`."""
