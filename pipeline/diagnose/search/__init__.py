"""Fits and comparisons: the plain model, single causes, several causes, held-out gain, what is left."""
