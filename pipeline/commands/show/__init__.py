"""What commands print: rows, diagnoses, the state of a lab, a controller study, all safe for a terminal."""
