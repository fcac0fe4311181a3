"""Plans of life tests: which voltages, how many specimens, how long; when to stop; how many tell two designs apart."""
