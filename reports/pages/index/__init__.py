"""The first page of a lab and its lists."""
