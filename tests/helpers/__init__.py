"""Files, labs and machines that several tests need."""
