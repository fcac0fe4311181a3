"""Models and numbers from responses: relaxation models, survival, sensing, force maps. Pure functions."""
