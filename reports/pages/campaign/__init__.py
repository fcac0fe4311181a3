"""A campaign's page and its parts."""
