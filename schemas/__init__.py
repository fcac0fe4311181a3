"""What crosses a border: quantities and units, protocols, metadata, recordings, tables and SQL views.

Belongs here: names, types, units and their checks. Does not belong here: reading files, numerics, processes.
Imports nothing of the other packages.
"""
