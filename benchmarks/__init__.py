"""The one place where speed is measured: `python -m benchmarks [NAME ...]`."""
