"""One file per command of `dealab`. What they show is here; what they ask is elsewhere."""
