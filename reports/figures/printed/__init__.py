"""Figures that leave the page, by matplotlib: for a paper, a thesis, a notebook. Each function takes data and returns a `Figure`."""
