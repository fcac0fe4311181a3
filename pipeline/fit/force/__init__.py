"""Static force against pre-stretch."""
