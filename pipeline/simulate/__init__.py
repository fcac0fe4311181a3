"""The virtual rig: excitation, film, clamp and load cell, amplifier, sensors; campaigns; the film's finite elements."""
