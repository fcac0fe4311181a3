"""A recording's page and its parts."""
