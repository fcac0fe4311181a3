"""One module per kind of page or part of it: queries in, blocks out. Sentences common to several are in `findings`."""
