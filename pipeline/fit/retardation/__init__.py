"""How a film gives way under a drive that is held: creep and recovery, and strokes under a voltage at constant load."""
