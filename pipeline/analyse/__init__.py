"""From checked recordings to tables: which transform and which fit for which protocol, and what to do when one fails.

Thin: the science is in `pipeline.transform` and `pipeline.fit`. Results become rows by the names of their members
(`schemas.tables`); where a table is laid out otherwise than its results, the analysis that makes them says how. No
files here.
"""
