"""The tests that a rig can make: parameters, duration, what the metadata say, and the signals they give on a bench.

One class per test. A procedure states its inputs; the bench answers them. Lifetimes, which end by a breakdown, and tests
in closed loop, which decide while they run, have files of their own beside this folder.
"""
