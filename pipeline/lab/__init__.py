"""What a lab is on disk: the published snapshot, the journal, queries, locks, settings, and the door for notebooks."""
