"""A specimen's page and its parts."""
