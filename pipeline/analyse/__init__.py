"""From checked recordings to tables: which transform and which fit for which protocol, and what to do when one fails.

Thin: the science is in `pipeline.transform` and `pipeline.fit`, the rows are made in `pipeline.tabulate`. No files here.
"""
