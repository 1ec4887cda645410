"""What nets see of the machine: the data objects of the DOM, whose commands they are, and last messages."""
