"""A fitted film as an actuator: its specification with limits, sizes for a requirement, assemblies of several."""
