"""Figures and pages, made from the published database alone. Nothing is measured or fitted here."""
