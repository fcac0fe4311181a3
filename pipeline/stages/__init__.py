"""The nightly's stages as workers run them: an item in, its results in the journal, a small outcome back.

A stage's code version covers everything that its module imports, so a stage imports what its results depend on and
nothing else.
"""
