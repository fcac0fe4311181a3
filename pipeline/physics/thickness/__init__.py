"""Thickness of a film that was stretched over rods, by finite elements.

The material is Ogden's law of `hyperelastic`; `incremental` is the scheme of the thesis with its errata corrected,
`continuous` one hyperelastic problem solved by Newton's method, `layout` what electrodes on such a film would meet.
Plane stress, incompressible.

Directions, in all modules: x along the rods (thesis, direction 2), y across them (thesis, direction 1).
"""
