"""The machine as seen by nets: data objects of the DOM, the commands, and last messages."""
