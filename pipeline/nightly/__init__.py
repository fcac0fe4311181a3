"""A night, step by step: look, read, own, derive, publish."""
