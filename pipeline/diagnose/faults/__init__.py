"""Recordings first: which of them says something else than the others or than its own metadata, and by which fault."""
