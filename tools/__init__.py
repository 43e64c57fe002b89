"""What is done to the repository as a whole, and by nobody who uses it."""
