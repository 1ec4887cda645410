"""Messages: types by name, fields as plain data, stamps, and errors as a status."""
