"""One module per kind of evidence; each function draws one figure that answers one question, from plain arrays."""
