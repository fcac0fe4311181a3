"""Handing on a lab: an archive of its results with hashes, figures, report and provenance, and its verification."""
