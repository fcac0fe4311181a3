"""Every figure and table of the thesis against the demonstration: `python -m tests.thesis LAB`."""
