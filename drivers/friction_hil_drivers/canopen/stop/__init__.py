"""Taking the power of drives, and leaving them as they were found."""
