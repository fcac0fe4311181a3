"""Records that are asked without a session: one large cycle, a system of another kind."""
