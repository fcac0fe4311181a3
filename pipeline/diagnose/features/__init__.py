"""From recordings to features: linear functionals of samples, each with its noise."""
