"""Relaxation models of a specimen from its responses."""
