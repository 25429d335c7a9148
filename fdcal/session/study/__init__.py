"""A study: many seeded calibrations over the axes of a file, on Dask, written to Parquet as they come.

`definition` reads the file, `task` runs one calibration, `cluster` many of them, `results` keeps the table.
"""
