"""From a file to a checked `Recording`: one reader per format, mapping, validation, samples Parquet, quarantine.

Does not belong here: anything computed from samples (pipeline.transform), the database (pipeline.store).
"""
