"""What is run by hand or by make: generated documents, comparison of labs."""
