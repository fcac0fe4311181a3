"""Film, rig, hyperelasticity, excitation and least squares: written once, used by fit, simulate and diagnose."""
