"""The machine as nets see it: data objects of the DOM, the commands, and last messages."""
