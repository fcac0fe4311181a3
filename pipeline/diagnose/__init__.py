"""What the simulation of a specimen's recordings gets wrong, which cause explains it, and what mending it gains."""
