"""What recording costs, and whether anything is lost."""
