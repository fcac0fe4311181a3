"""Lifetimes: survival curves, comparisons, distributions, life against voltage."""
